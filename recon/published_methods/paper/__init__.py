"""SpectralCTGaussians, the published method, part by part: ``recon fit --recipe paper``.

One file per part, named as in the paper: `model` (factorised density and fractions, eq. 2), `spectral` (64 energies,
eq. 4), `edge` (learnable K edge and basis conditioning), `projector` (eq. 5), `start` and `fractions` (initialisation),
`ssim`, `variation` and `loss` (eq. 8), `adam` and `densify` (optimisation), `fitting` (the loop). What the paper leaves
open is filled from R2-Gaussian, which it builds on; docs/explanation/paper_recipe.md lists both.
"""
