"""Landmark recognition by Rowell, Dunstan, Parkes, Gil-Fernandez, Huertas and Salehi (2015).

One module for each stage of sections 2 and 3 of the paper; each stage is a function of plain values.

Data base (section 2)
    ``corners`` -> ``build.extract_candidates`` -> ``clustering`` -> ``hull`` -> ``database``
Recognition (section 3)
    ``projection`` and ``visibility`` -> ``centroid`` (or ``alignment``) -> ``matching`` -> ``pose`` -> ``recognizer``
"""
