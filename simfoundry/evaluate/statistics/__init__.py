"""Statistics of rollouts: records, success rates, comparisons, and correlation with results on real robots."""
