"""Features that display a document: hovers, hints, symbols, colors, links and pictures."""
