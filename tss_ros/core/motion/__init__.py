"""How a state moves: integration in time, with slack/taut switches and variations."""
