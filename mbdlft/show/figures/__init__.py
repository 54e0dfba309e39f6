"""Figures of finished models."""
