"""Fletcher-32, the checksum that HDF5 appends to a chunk, for chunks that are packed outside HDF5.

Reference: J. G. Fletcher 1982, doi:10.1109/TCOM.1982.1095369; HDF5 File Format Specification 3.0, section IV.A.2.l.
"""

import numpy as np

_MODULUS = 65535
_BLOCK = 1 << 16  # words whose weighted sum stays below 2^63


def fletcher32(data: bytes) -> bytes:
    """Compute the checksum of a chunk as HDF5 stores it behind the chunk.

    With big-endian words w of 16 bits, n of them, the sums are s1 = sum_i w_i and s2 = sum_i (n - i) w_i, both modulo
    65535 in one's complement, where a multiple of 65535 is written 65535, and only zeros give 0.

    Parameters
    ----------
    data : bytes of the chunk

    Returns
    -------
    four bytes, those of s2 first and the low byte of each number last, as a little-endian number
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), ">u2").astype(np.int64)
    first = second = 0
    for start in range(0, len(words), _BLOCK):
        block = words[start : start + _BLOCK]
        total = int(block.sum())
        second = (second + len(block) * first + int(block @ np.arange(len(block), 0, -1))) % _MODULUS
        first = (first + total) % _MODULUS
    if words.any():
        first, second = first or _MODULUS, second or _MODULUS
    return ((second << 16) | first).to_bytes(4, "little")
