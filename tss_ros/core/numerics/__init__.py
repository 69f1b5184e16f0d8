"""Mathematics without satellites."""
