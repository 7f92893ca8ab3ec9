"""What people can do in the studio. Each act is data, and computes the edits of documents that it stands for.

Each module contains a family of acts. An act is a frozen dataclass with a ``label`` and a method ``edits``.
"""
