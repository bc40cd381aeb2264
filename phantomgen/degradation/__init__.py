"""A scan made worse than it was: less dose, fewer views, a smaller or coarser panel, wrong statements.

Functions of arrays in `dose`, `views`, `panel` and `misstatements`; `settings` says what is wanted, `degraded_scan`
applies it to one dataset, and `run` reads and writes files.
"""
