"""The paper's experiments (Section 3) in the planar environment."""
