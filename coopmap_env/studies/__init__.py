"""The experiments of the paper and of the benchmark, as customers of the library."""
