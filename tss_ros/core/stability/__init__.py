"""What a motion is worth: periodic motions, Floquet multipliers, verdicts, critical rates."""
