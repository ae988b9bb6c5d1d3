"""How estimates and recordings are shown: words, numbers, tables, JSON, figures, pages.

Imports all that it shows, and no study.  Start at `words` and `terminal`; `plots`
has what notebooks and pages draw, `style` the colours that every figure shares.
"""
