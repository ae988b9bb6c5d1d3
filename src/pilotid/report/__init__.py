"""Pages and terminal output: of a fit, a check, a posterior, a design, a study, the paper.

Imports what it shows, and `plots`.  Start at `fit`; each page has a module here and a template.
"""
