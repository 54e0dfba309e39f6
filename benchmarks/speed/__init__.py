"""What `benchmarks.speed_error` compares: four systems, the truth about them, and the methods."""
