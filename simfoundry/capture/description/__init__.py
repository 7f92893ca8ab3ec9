"""The objects of a reconstruction as entries of a spec: names, kinds, materials and masses."""
