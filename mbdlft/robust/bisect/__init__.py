"""Branch and bound: the box of parameters and all frequencies are cut until no polynomial can vanish."""
