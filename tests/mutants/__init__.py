"""Bugs that are planted one after the other; each must fail a test."""
