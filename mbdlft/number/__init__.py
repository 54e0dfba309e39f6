"""Number systems for expressions, SX tapes and matrices, one in each file.

A system of scalars is a class with ``+ - * /``, also with floats; the function of the same name in small
letters makes one of a number. ``FUNCTIONS`` are its other operations, by their names in CasADi.
"""
