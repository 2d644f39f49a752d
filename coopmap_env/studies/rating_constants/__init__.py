"""The choice of K, n and the number of bins of the rating function, on training worlds."""
