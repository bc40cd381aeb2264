"""Voxel reconstruction: the interface of a method, filtered and iterative methods, and initial volumes of a fit."""
