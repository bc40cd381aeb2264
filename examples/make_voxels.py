"""Write voxels.npy beside this file: labels of a bone (2) with marrow (3) in tissue (1), for voxels.yaml."""

from pathlib import Path

import numpy as np

z, y, x = (np.indices((96, 64, 64)) - np.array([47.5, 31.5, 31.5]).reshape(3, 1, 1, 1)) * 0.5
shaft = 7 + 4 * (z / 24) ** 4  # radius [mm], wider at both ends
labels = np.where(np.hypot(x, y) < shaft, 2, 1)
labels[np.hypot(x, y) < shaft - 2.5] = 3

if __name__ == "__main__":
    np.save(Path(__file__).with_name("voxels.npy"), labels.astype(np.uint8))
