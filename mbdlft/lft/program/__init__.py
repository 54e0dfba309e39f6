"""Straight-line programs: written on a tape, run by numpy or as native code. numpy only."""
