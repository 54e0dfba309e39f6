"""The command line: one file for each group of commands, and the tables and reports that they print."""
