"""How recordings and estimates are drawn: plots for notebooks, figures, and what makes a page.

Imports all that it shows, and no study.  Start at `plots`; `style` has the colours that every
figure shares, `page` fills the templates.
"""
