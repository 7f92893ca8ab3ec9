"""Augmentation: new demonstrations from segments of recorded ones, adapted to other initial states, scenes and objects.

The idea is that of MimicGen (Mandlekar et al., 2023), with its extensions to planned motions (SkillMimicGen) and to two
arms (DexMimicGen).
"""
