"""Components for rmpc-bench in a package of their own."""
