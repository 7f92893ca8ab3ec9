"""Acts of people in the studio. Each act is plain data, and computes the edits of the documents.

Each module contains a family of acts. An act is a frozen dataclass with a ``label`` and a method ``edits``.
"""
