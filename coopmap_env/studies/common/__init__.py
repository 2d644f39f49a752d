"""Figures, report pages and the hit/miss map, which several studies use."""
