"""What can be set: types, ranges, units, words; the units that samples give."""
