"""SpectralCTGaussians, a published method, component by component: ``recon fit --recipe paper``.

`model` has the factorised density and fractions (eq. 1 and 2), `spectral_model` the 64 energies (eq. 3 and 4),
`projections` the line integrals (eq. 5), `loss` the loss (eq. 8), `learned_edge` the learned K edge and the
conditioning of the basis, `initialize` the start, `adam` and `density_control` the optimisation, `optimize` the loop,
`recipe` all numbers, and `reconstruct` the steps from a dataset to a model. What the article leaves open is taken from
R2-Gaussian, on which it builds; docs/explanation/paper_recipe.md lists both.

References
----------
Vos, Sinha, Weinmann, SpectralCTGaussians; equation and table numbers in this folder are those of the article. Zha, Lin,
Cai, Cao, Zhang, Li 2024, R2-Gaussian: rectifying radiative Gaussian splatting for tomographic reconstruction, NeurIPS,
arXiv:2405.20693.
"""
