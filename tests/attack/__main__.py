"""The command of the attacks; see `tests.attack`."""

import argparse
import itertools
import sys
import time

from tests.attack import CLASSES
from tests.attack.run import Attacker, command, once, tally


def main() -> None:
    """Attack, print one line for each class and a command for each seed that failed."""
    parser = argparse.ArgumentParser(description="Attack the package with hostile inputs.")
    parser.add_argument("--minutes", type=float, default=5.0, help="for all classes together")
    parser.add_argument("--only", default=",".join(CLASSES), help="classes, with commas")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--count", type=int, help="seeds of each class; without it, until the end")
    options = parser.parse_args()
    names = options.only.split(",")
    if unknown := set(names) - set(CLASSES):
        parser.error(f"unknown classes {', '.join(unknown)}. There are: {', '.join(CLASSES)}.")
    if options.count == 1:
        for name in names:
            print(f"{name}: {once(name, options.seed)}")
        return
    failed, attacker = {}, Attacker()
    for k, name in enumerate(names):
        share = 60.0 * options.minutes / len(names)
        seeds = itertools.count(options.seed)
        chosen = itertools.islice(seeds, options.count)
        found = tally(attacker, name, chosen, time.monotonic() + share)
        print(f"[{k + 1}/{len(names)}] {found.line()}", flush=True)
        failed |= {(name, seed): why for seed, why in found.failed.items()}
    attacker.end()
    for name, seed in failed:
        print(f"again: {command(name, seed)}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
