"""Statistics of rollouts: records, success rates, comparisons, correlation with real robots."""
