"""The paper redone figure by figure, and its claims judged."""
