"""How estimates and recordings are shown: words, numbers, tables, JSON, figures, pages.

Imports all that it shows, and no study.  Start at `words` and `terminal`; `style` has the
colours that every figure shares.
"""
