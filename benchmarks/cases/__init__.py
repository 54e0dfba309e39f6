"""Systems whose answers are known, and how: benchmarks measure them, tests hold the package to them."""
