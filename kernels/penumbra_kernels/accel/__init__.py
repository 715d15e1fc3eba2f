"""Building the trees that the tracer walks: boxes -> binary tree -> eight-wide nodes and packets."""
