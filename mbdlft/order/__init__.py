"""How small an LFT is, and could be: n-D reduction, the search for fewer repetitions, lower bounds."""
