"""Gaussians that a plane divides into two sides with coefficients of their own, seen along rays."""
