"""Lints: what the language allows and yet will not work, one file a finding, judged on the lowered scene."""
