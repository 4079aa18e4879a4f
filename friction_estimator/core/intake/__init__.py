"""Events to admitted samples: pairing, order, gaps, standstill."""
