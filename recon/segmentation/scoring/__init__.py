"""Scores of material maps against the truth."""
