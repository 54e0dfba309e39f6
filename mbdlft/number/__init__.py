"""Number systems for expressions and matrices: intervals, dimensions, Taylor models, twofold."""
