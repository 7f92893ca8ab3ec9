"""Scene layouts for cousins: placement constraints, pose sampling, settling and acceptance."""
