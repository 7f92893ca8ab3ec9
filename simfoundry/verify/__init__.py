"""The proof that a build means the same in every simulator: what each one holds, and how it behaves."""
