"""Basis functions of energy, changes from one basis to another, and combinations of them for solvers."""
