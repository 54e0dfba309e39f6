"""The catalogue of bodies: for each a description, its data, and the script that made the data."""
