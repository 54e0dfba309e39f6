"""Parameters that move: quadratic forms that prove stability, and motions that destabilize."""
