"""What the paper says of each picture, and what is to be seen in ours."""

#: Name of the picture, its title, what the paper says of it, and what ours shows.
PICTURES = (
    (
        "table_1",
        "Table 1",
        "Parameters of the tethered satellite system; no damping coefficient among them.",
        "The same values, and the damping identified from the claim of 2.17.",
    ),
    (
        "figure_03",
        "Fig. 3",
        "At 2.0, undisturbed, the formation maintains its initial configuration.",
        "The paths lie on one circle for the first two turns, then the triangle folds: the end"
        " (filled) is a narrow triangle off the circle. Shorter runs would look like the paper's.",
    ),
    (
        "figure_04",
        "Fig. 4",
        "At 2.5, undisturbed, the formation maintains its initial configuration.",
        "All paths on one circle, the triangles of start and end almost the same: as described.",
    ),
    (
        "figure_05",
        "Fig. 5",
        "The multipliers leave the unit circle when the rate falls below about 2.17.",
        "Tethers first go slack at 2.17; a little below, at 2.14, the motion is unstable in its"
        " spin, and from 2.11 down none closes any more. The frozen curve lies at 1.00"
        " throughout and marks nothing. All of this is about Eq. (6); disturbed rings whose tethers"
        " only pull are held beyond 2.50 (dashed line).",
    ),
    (
        "figure_06",
        "Fig. 6",
        "At 2.0 the disturbed configuration cannot be held.",
        "The satellites leave the circle after two turns; then the triangle no longer spins, but"
        " satellite 2 swings about the upper end of the vertical, 1 and 3 about the lower: as"
        " described.",
    ),
    (
        "figure_07",
        "Fig. 7",
        "At 2.5 the disturbed system converges to the original configuration in about 2 turns.",
        "One circle, thickened on both sides by the drift of the centre of mass along the orbit;"
        " the triangle itself is restored within the first turn, by tethers that push for 13 % of"
        " the time. With tethers that only pull it is lost after 11.3 turns.",
    ),
    (
        "figure_08",
        "Fig. 8",
        "The deviation is not attenuated at 2.0 and decays to 0 at 2.5.",
        "At 2.0 both measures grow beyond 40 %. At 2.5 the one from the centre of mass decays"
        " within half a turn to the ripple that the gravity gradient forces; the one from the"
        " origin (53) does not decay but grows to 5 %, because a displaced centre of mass drifts.",
    ),
    (
        "figure_09",
        "Fig. 9",
        "The critical rate is 2.79 at 50 kg and 2.07 at 1000 kg.",
        "Both masses first go slack at 2.17 and lose their periodic motion a little below, like"
        " 100 kg: around 2.79 the light ring shows nothing,"
        " at 2.07 the heavy one has no closing motion. 2.07 would need more damping. With tethers"
        " that only pull the disturbed rings of both masses are held beyond 2.50.",
    ),
    (
        "figure_10",
        "Fig. 10",
        "50 kg: lost at 2.5; at 2.9 the configuration is held after about 2 turns.",
        "Both rows look alike, a circle and an unchanged triangle: 2.5 is held as well as 2.9. The"
        " deviation from the origin grows with the drift, that from the centre of mass is a line"
        " at 0. At 2.5 tethers push for 13 % of the time, at 2.9 never: with tethers that only pull"
        " 2.5 is lost after 11.3 turns, and 2.9 is held as here.",
    ),
    (
        "figure_11",
        "Fig. 11",
        "1000 kg: lost at 1.5; at 2.2 back to the configuration in about 3 turns.",
        "At 1.5 the triangle folds within two turns and hangs along the local vertical, one"
        " satellite below, two above; at 2.2 the circle and the triangle are kept: as described,"
        " but by tethers that push for 28 % of the time. With tethers that only pull 2.2 is lost"
        " after 1.4 turns.",
    ),
    (
        "figure_13",
        "Fig. 13",
        "The 6 beads have their critical rate at about 2.08, like 1000 kg without beads.",
        "Nothing changes at 2.08: large multipliers on both sides of it. The circle is reached at"
        " 2.64, with a band of instability above 2.99. With tethers that only pull the disturbed"
        " ring is held beyond 2.72 (dashed line).",
    ),
    (
        "figure_14",
        "Fig. 14",
        "6 beads: lost at 1.5; at 2.2 each path approaches a circle in about 10 turns.",
        "At 1.5 the ring hangs along the local vertical. At 2.2 the paths fill the disc and leave"
        " the plane by kilometres: no circle within 12 turns.",
    ),
    (
        "figure_15",
        "Fig. 15",
        "At 2.2 the tether lengths settle, the distances of the beads keep oscillating.",
        "At 2.2 lengths stay near L after five turns but for slack moments, and the distances swing"
        " by their full size. At 1.5, too, the lengths calm down, in a ring that hangs.",
    ),
)
