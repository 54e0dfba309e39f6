"""CasADi SX tapes: one fold for every number system, and values at many points."""
