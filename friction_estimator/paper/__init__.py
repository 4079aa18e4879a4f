"""The paper's experiments repeated, and its claims put to the test (Kwak, Yagle, Levitt 1998)."""
