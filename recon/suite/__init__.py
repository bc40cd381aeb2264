"""Scores of methods and of other programs on a suite of scans that `phantomgen suite` made."""
