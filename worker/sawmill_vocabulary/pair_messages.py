"""Messages on the calibration of a scanner of fixed pairs."""

from sawmill_vocabulary.messages import N_, Message

_ROLL = N_("Roll the board by about a quarter of a turn and pass it again, then calibrate with all passages.")


class PairMessage(Message):
    """Reasons of the verdict on a scanner of fixed pairs."""

    ROLL_AGAIN = (
        "roll-again",
        N_("Not precise enough yet: the error may be up to %(upper_mm).3f mm, and %(allowed_mm).3f mm is allowed."),
        _ROLL,
        N_(
            "The predicted ray error is %(rms_mm).3f mm (RMS) from %(passages)d passages, with 95 %% below "
            "%(upper_mm).3f mm."
        ),
    )
    LIES_ALIKE = (
        "lies-alike",
        N_("The board lies nearly alike in passages %(first)d and %(second)d."),
        _ROLL,
        N_("Its rolls differ by %(apart_deg).0f degrees; the second passage then adds little."),
    )
    SWINGS = (
        "pairs-swings",
        N_("The pairs see the board at places that differ by about %(swing_mm).2f mm."),
        N_(
            "Fasten the board so that it cannot roll or swing on the feed, check that all files have the passages in "
            "the same order, and pass it again. If that does not help, use a straight board without knots."
        ),
        N_("Each pair sees it elsewhere in each passage; what is alike in all passages does not show."),
    )
    NO_FIT = (
        "pairs-no-fit",
        N_("The passages do not fit this drawing: %(left_percent).1f %% of the shadow is left."),
        N_(
            "Check the drawing, the side from which the board is seen, the order of the files, and that the board does "
            "not slant."
        ),
        N_("A fit leaves at most %(allowed_percent).1f %%."),
    )
    OTHER_SIDE = (
        "pairs-other-side",
        N_("The board seen from the other side fits better."),
        N_("Check from which side the board is seen, and the order in which each detector's cells count."),
        N_("It leaves %(other_percent).1f %% of the shadow, this side %(left_percent).1f %%."),
    )
    NOT_CONVERGED = (
        "pairs-not-converged",
        N_("The fit has not ended."),
        N_("Pass the board again, or give nominal places that are nearer to the true ones."),
        "",
    )
    BACKWARDS = (
        "pair-backwards",
        N_("The cells of pair %(pair)d count counter-clockwise."),
        "",
        N_("The other order is worse by %(deviations).0f standard deviations."),
    )
    ORDER_UNCERTAIN = (
        "pair-order-uncertain",
        N_("It is not certain which way the cells of pair %(pair)d count."),
        N_("State cell_order of the pair, or pass the board again in another roll."),
        N_("The other order is worse by only %(deviations).1f standard deviations."),
    )
    APART = (
        "pairs-apart",
        N_("The pairs show parts of the board up to %(apart_mm).0f mm apart, and each shows %(rows_mm).0f mm of it."),
        N_("Record more rows, so that all files show the same part of the board."),
        N_("A slanted or twisted board lies elsewhere there, and the bound is then too small."),
    )
    FAR_AWAY = (
        "pair-far-away",
        N_("Pair %(pair)d stands far from its nominal place: by %(deviations).1f standard deviations."),
        N_(
            "Check its nominal place, the order of the files, and that all files have the passages in the same order "
            "and from the same end."
        ),
        "",
    )
    SCALE = (
        "pairs-scale",
        N_(
            "Sizes are not certain enough: they may be wrong by %(percent).2g %%, and %(allowed_percent).2g %% is "
            "allowed."
        ),
        N_("Measure the board, and give its size with its tolerance."),
        N_("The corners of the board are %(corners_mm).2f mm off the drawing's (RMS)."),
    )
    SLANTS = (
        "pairs-slants",
        N_("In passage %(passage)d the board slants by %(slant_deg).1f degrees, or moves sideways while it is fed."),
        N_("Lay it along the feed, guide it, and pass it again."),
        N_("At most %(allowed_deg).0f degrees are taken for a slant."),
    )
