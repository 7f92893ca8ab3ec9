"""What editors show of a document: hovers, hints, symbols, colors, links and pictures."""
