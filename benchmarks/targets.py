"""Relative errors promised in docs/measured.md; benchmarks refuse to print beyond them."""

EPS = 2.0**-52  # distance of 1.0 to the next float

CLOSED_FORM = 1e-12
FREQUENCY_RESPONSE = 1e-10
SCENARIO = 1e-11
PINOCCHIO = 1e-9
PUBLIC = 1e-9  # robots of other people, against the tools of their formats
# matrices of a finite-element mesh after solves with them: what their condition leaves
BALANCE = 1e-8

# times EPS and the condition of an entry or pole, measured with 50 digits, on the hard cases
HARD = 20.0
# a numeric linearization that is as good as the condition permits
HARD_NUMERIC = 5.0
