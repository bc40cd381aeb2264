"""Dose of a scan: a map over the scene, and CTDI in the cylinders of quality assurance."""
