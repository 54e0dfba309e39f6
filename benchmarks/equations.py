"""Seconds of models of equations: rows of masses, springs, dampers and friction, to certified form.

python -m benchmarks.equations
"""

import sys
import time

from benchmarks.cases.mass_chain import chain
from mbdlft.pipeline import delta_theta, linearize_dae

UNITS = (5, 15, 50)  # of ten equations each
PROMISED = 5.0  # s for 500 equations, of one core


def main() -> int:
    """Print a table; 1 if the largest model takes longer than promised."""
    worst = 0.0
    print("equations | Delta-Theta (s) | linear (s) | order | bound")
    for units in UNITS:
        dae, seconds = chain(units), []
        for make in (delta_theta, linearize_dae):
            start = time.process_time()
            model = make(dae)
            seconds.append(time.process_time() - start)
        certificate = model.certificate
        print(
            f"{len(dae.equations):9d} | {seconds[0]:15.2f} | {seconds[1]:10.2f} | "
            f"{sum(certificate.order):5d} | {certificate.order_bound:5d}"
        )
        worst = max(seconds)
    return int(worst > PROMISED)


if __name__ == "__main__":
    sys.exit(main())
