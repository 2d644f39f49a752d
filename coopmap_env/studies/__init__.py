"""The experiments of the paper and of the benchmark; they use the library as any program does."""
