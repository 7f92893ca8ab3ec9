"""Which pixels belong to the support and to each object: planes, edges, regions, and who stands on whom."""
