"""Datasets: demonstrations sampled at a fixed rate, with images, in the formats that training libraries read."""
