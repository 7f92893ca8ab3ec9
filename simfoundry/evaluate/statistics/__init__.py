"""Statistics of rollouts: records, success rates, comparisons, and correlation with real robots."""
