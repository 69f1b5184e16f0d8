"""What all nodes share: start and end, parameters, topics, messages."""
