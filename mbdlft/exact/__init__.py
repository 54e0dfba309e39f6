"""Number systems for expressions, SX tapes and matrices, one in each file.

A system of scalars is a class of `Operators`, whose `of` makes an element of a number; ``FUNCTIONS`` of
its file are further operations, by their names in CasADi.
"""
