"""What the paper says of each picture, and what is to be seen in ours."""

#: Name of the picture, (title, the paper's words in short), and what ours shows.
PICTURES = (
    ("table_1", ("Table 1", "Parameters of the tethered satellite system."), "SEEN"),
    ("figure_03", ("Fig. 3", "Undisturbed at 2.0: the initial configuration is maintained."), "SEEN"),
    ("figure_04", ("Fig. 4", "Undisturbed at 2.5: the initial configuration is maintained."), "SEEN"),
    ("figure_05", ("Fig. 5", "Multipliers against the rate: stable beyond 2.17."), "SEEN"),
    ("figure_06", ("Fig. 6", "Disturbed at 2.0: the configuration cannot be held."), "SEEN"),
    ("figure_07", ("Fig. 7", "Disturbed at 2.5: back to the configuration in about 2 turns."), "SEEN"),
    ("figure_08", ("Fig. 8", "Deviation: not attenuated at 2.0, decays to 0 at 2.5."), "SEEN"),
    ("figure_09", ("Fig. 9", "Multipliers at 50 kg, critical at 2.79, and 1000 kg, at 2.07."), "SEEN"),
    ("figure_10", ("Fig. 10", "50 kg: lost at 2.5, held in about 2 turns at 2.9."), "SEEN"),
    ("figure_11", ("Fig. 11", "1000 kg: lost at 1.5, back in about 3 turns at 2.2."), "SEEN"),
    ("figure_13", ("Fig. 13", "Multipliers of the 6 beads: critical at 2.08."), "SEEN"),
    ("figure_14", ("Fig. 14", "6 beads: lost at 1.5; nearly circular orbits at 2.2."), "SEEN"),
    ("figure_15", ("Fig. 15", "6 beads at 2.2: lengths settle, distances keep oscillating."), "SEEN"),
)
