"""Constants of physics (CODATA 2018, doi:10.1103/RevModPhys.93.025010)."""

ELECTRON_REST_ENERGY = 510.99895  # m_e c^2 [keV]
PLANCK_LIGHT = 12.398419843  # h c [keV Angstrom]
