"""Numbers of the tables of SpectralCTGaussians (Vos, Sinha, Weinmann), for comparison with those measured here.

They are of other scans, so that only the order of methods and differences between rows can be compared. Channels are at
50, 80 and 120 keV; scores are PSNR [dB], SSIM and LPIPS.
"""

from typing import NamedTuple


class Printed(NamedTuple):
    """Scores in one cell of a table.

    Parameters
    ----------
    psnr : [dB]
    ssim : structural similarity
    lpips : perceptual distance; None where the table has none
    """

    psnr: float
    ssim: float
    lpips: float | None = None


# Table 1, averages of the three channels, bird chest: row -> novel views, volumes beside back-projection of all views
TABLE_1: dict[str, tuple[Printed, Printed | None]] = {
    "FDK": (Printed(29.85, 0.660, 0.187), Printed(20.09, 0.319, 0.373)),
    "SART": (Printed(34.36, 0.863, 0.250), Printed(24.49, 0.554, 0.429)),
    "CGLS": (Printed(34.15, 0.830, 0.234), Printed(18.62, 0.269, 0.457)),
    "PDHG-TV": (Printed(34.27, 0.852, 0.255), Printed(23.61, 0.599, 0.477)),
    "IntraTomo": (Printed(28.15, 0.803, 0.399), Printed(23.77, 0.565, 0.411)),
    "SAX-NeRF": (Printed(31.43, 0.854, 0.332), Printed(20.89, 0.503, 0.461)),
    "X-Gaussian": (Printed(25.59, 0.854, 0.239), None),
    "R2-Gaussian": (Printed(37.33, 0.953, 0.272), Printed(24.06, 0.674, 0.395)),
    "X-Field": (Printed(28.84, 0.872, 0.348), None),
    "Ours (2)": (Printed(35.92, 0.940, 0.284), Printed(26.94, 0.612, 0.396)),
    "Ours (3)": (Printed(36.52, 0.943, 0.283), Printed(26.57, 0.634, 0.402)),
}

# Table 2, synthetic phantom: row -> photoelectric, Compton, K edge
TABLE_2: dict[str, tuple[Printed, Printed, Printed | None]] = {
    "FDK": (Printed(20.04, 0.548), Printed(21.41, 0.694), Printed(25.64, 0.573)),
    "SART": (Printed(20.81, 0.666), Printed(21.44, 0.779), Printed(25.90, 0.596)),
    "CGLS": (Printed(20.09, 0.684), Printed(21.63, 0.806), Printed(25.61, 0.606)),
    "PDHG-TV": (Printed(20.67, 0.720), Printed(21.38, 0.808), Printed(26.03, 0.597)),
    "Ours (2)": (Printed(23.64, 0.853), Printed(15.56, 0.814), None),
    "Ours (3)": (Printed(23.82, 0.863), Printed(15.28, 0.808), Printed(20.59, 0.898)),
}

# Table 3, synthetic phantom: bases -> pictures of the material maps
TABLE_3: dict[int, Printed] = {2: Printed(30.11, 0.985, 0.062), 3: Printed(30.97, 0.989, 0.047)}

# Table 4a: bases -> PSNR of the 50, 80 and 120 keV channel that was held out, and of the same channel in Table 1
TABLE_4A: dict[int, tuple[tuple[float, float], ...]] = {
    2: ((30.05, 32.99), (34.79, 35.67), (30.92, 39.09)),
    3: ((24.99, 33.76), (30.56, 36.79), (28.22, 39.03)),
}

# Table 4b: training views -> PSNR of the three channels
TABLE_4B: dict[int, tuple[float, float, float]] = {
    75: (33.76, 36.79, 39.03),
    50: (33.63, 36.61, 38.86),
    25: (33.00, 35.96, 38.46),
    10: (30.73, 33.88, 37.14),
}

# Table 4c: component that is left out -> PSNR of the three channels
TABLE_4C: dict[str, tuple[float, float, float]] = {
    "": (33.76, 36.79, 39.03),
    "kedge-freezing": (33.79, 36.78, 38.95),
    "tv": (33.77, 36.78, 39.01),
    "split-threshold": (33.64, 36.65, 38.90),
    "polychromatic": (34.31, 37.20, 39.20),
}
