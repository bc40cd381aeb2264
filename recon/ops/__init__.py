"""Operators of the reconstructor, one folder each: reference, kernel, public function."""
