"""Phantom files of other programs become scenes."""
