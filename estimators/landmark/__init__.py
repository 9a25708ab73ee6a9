"""Landmark recognition by Rowell, Dunstan, Parkes, Gil-Fernandez, Huertas and Salehi (2015).

One module for each stage of sections 2 and 3 of the paper; each stage is a function without state.

Data base (section 2)
    ``corners`` -> ``database.extract_candidates`` -> ``clustering`` -> ``hull`` -> ``database``
Recognition (section 3)
    ``alignment`` -> ``projection`` (and visibility) -> ``matching`` -> ``pose``; all of them run by ``recognizer``
"""
