"""The command line: one file for each group of commands, and the tables that they print."""
