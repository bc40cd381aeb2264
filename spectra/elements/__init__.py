"""Tables of elements and compositions.

Attenuation, edges, formulas, named compositions; xraylib is imported in attenuation.py only.
"""
