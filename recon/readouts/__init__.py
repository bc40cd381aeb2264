"""Physical numbers from basis volumes: attenuation and CT numbers at any energy, electrons, contrast agents."""
