"""Catalogue of bodies: a description, its data, and the script that made them."""
