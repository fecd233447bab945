"""Messages on what was found in a scan of the phantom: effects beyond the plain model, and faults."""

from sawmill_vocabulary.messages import N_, Message

_STRAIGHT = N_("Use straight, dry wood for the phantom, or draw it as it is.")
_ENCODER = N_("Look at the encoder and the drive: the encoder is off its axis, or the drive slips and catches.")
_LOST_VIEWS = N_(
    "Count the views that the detector sent, look at the drive and its encoder, and repeat the scan with all views."
)
_SLIP = N_("Fasten the phantom on the turntable, look at the drive and its encoder, and repeat the scan.")
_ANGLES_JUMP = N_("The angles jump by %(jump_deg).2g degrees at view %(view)d.")


class EffectMessage(Message):
    """Effects that are fitted with the geometry; the action is the remedy, where something should be done."""

    BEAM_HARDENING = "beam-hardening", N_("Beam hardening of %(change_percent)+.1f %% on the longest path.")
    SCATTER = (
        "scattered-radiation",
        N_("Scattered radiation, which adds %(added_percent).1f %% to the intensity of the deepest shadow."),
    )
    SCATTER_OR_HARDENING = (
        "scattered-radiation-or-hardening",
        N_("Scattered radiation, whose amount this scan does not tell from that of the beam hardening."),
    )
    BLUR = "blur", N_("A blur of %(blur_cells).2f detector cells (standard deviation).")
    LAG = "lag", N_("A lag of the detector, of %(lag_percent).1f %% of the view before.")
    EXPOSURE = (
        "rotation-during-exposure",
        N_("The phantom turns by %(turn_percent).0f %% of a step while a view is exposed."),
    )
    FLAT_FIELD = (
        "flat-field",
        N_(
            "The flat field has changed across the detector, by %(slope_percent)+.2f %% from end to end and "
            "%(ends_percent)+.2f %% at both ends."
        ),
        N_("Take new flat fields, right before the scan."),
    )
    DENSITY_GRADIENT = "density-gradient", N_("The wood's density slopes by %(slope_percent).1f %% in 100 mm.")
    DEFORMATION = (
        "deformation",
        N_(
            "The phantom is longer in x than in y against its drawing by %(longer_percent)+.2f %%, and sheared by "
            "%(sheared_percent)+.2f %%."
        ),
        N_("Measure both sides of the phantom, and check that it stands square to the axis."),
    )
    CORNERS = "corners", N_("Corners rounded by %(radius_mm).1f mm (radius).")
    PACE = (
        "pace",
        N_("The turntable turns %(factor).4f times as far as the angles say."),
        N_("Check the angles' step, the encoder's counts in a turn, and the clamps."),
    )
    PACE_LOST_VIEWS = (
        "pace-lost-views",
        N_("The turntable turns %(factor).4f times as far as the angles say: were views lost?"),
        _LOST_VIEWS,
    )
    PACE_LOST_END = (
        "pace-lost-end",
        N_("The turntable turns %(factor).4f times as far as the angles say: were views lost at the end?"),
        _LOST_VIEWS,
    )
    PHANTOM_CREEP = (
        "phantom-creep",
        N_("The phantom creeps by %(creep_mm).2g mm over the scan."),
        N_("Fasten the phantom on the turntable, and repeat the scan."),
    )
    SCANNER_CREEP = (
        "scanner-creep",
        N_("Source, turntable or detector creep by %(scanner_creep_mm).2g mm over the scan."),
        N_("Let the scanner warm up, look at what carries source and detector, and repeat the scan."),
    )
    PHANTOM_SETTLES = (
        "phantom-settles",
        N_("The phantom comes to rest during the scan, after %(settled_mm).2g mm."),
        N_("Fasten the phantom on the turntable, and repeat the scan."),
    )
    WARMS_UP = (
        "scanner-warms-up",
        N_("Source, turntable or detector come to rest during the scan, after %(scanner_creep_mm).2g mm."),
        N_("Let the scanner warm up, look at what carries source and detector, and repeat the scan."),
    )
    PHANTOM_UNSTEADY = (
        "phantom-unsteady",
        N_("The phantom moves unsteadily during the scan, by %(unsteady_mm).2g mm."),
        N_("Fasten the phantom on the turntable, and repeat the scan."),
    )
    SCANNER_UNSTEADY = (
        "scanner-unsteady",
        N_("Source, turntable or detector move unsteadily during the scan, by %(scanner_creep_mm).2g mm."),
        N_("Let the scanner warm up, look at what carries source and detector, and repeat the scan."),
    )
    ENCODER_LOW = (
        "encoder-once-and-twice",
        N_(
            "The angles are ahead and behind once a turn, by %(first_deg).2g degrees, and twice a turn, by "
            "%(second_deg).2g degrees."
        ),
        _ENCODER,
    )
    ENCODER_HIGH = (
        "encoder-three-and-four-times",
        N_(
            "The angles are ahead and behind three times a turn, by %(first_deg).2g degrees, and four times a turn, by "
            "%(second_deg).2g degrees."
        ),
        _ENCODER,
    )
    WOBBLE = (
        "wobble",
        N_("The turntable wobbles %(times)s a turn, by %(wobble_mm).2g mm."),
        N_("Look at the turntable's bearing and at what the phantom stands on."),
    )
    SURFACE_DENSITY = (
        "surface-density",
        N_("The wood within %(depth_mm).0f mm of the surface is %(change_percent).1f %% %(density)s."),
    )
    WOOD_DENSITY = (
        "wood-density",
        N_(
            "The wood's density seems to vary by %(deviation_percent).1f %% from place to place: by knots, a wet core, "
            "or what other corrections leave."
        ),
    )
    BOW = "bow", N_("The phantom is bent in its plane by %(bow_mm).2g mm."), _STRAIGHT
    TAPER = (
        "taper",
        N_(
            "The phantom is wider at one end than its drawing and narrower at the other, by %(taper_mm).2g mm at its "
            "corners."
        ),
        _STRAIGHT,
    )
    SLIP = ("slip", N_("The phantom moved at view %(view)d, by %(slip_mm).2g mm and %(slip_deg).2g degrees."), _SLIP)
    ANGLES_JUMP = "angles-jump", _ANGLES_JUMP, _SLIP
    ANGLES_JUMP_VIEWS = "angles-jump-views", _ANGLES_JUMP, _LOST_VIEWS
    LOST_VIEWS = (
        "lost-views",
        N_("The angles jump by %(jump_deg).2g degrees at view %(view)d: were %(lost)d views lost?"),
        _LOST_VIEWS,
    )
    LOST_AT_RANDOM = (
        "lost-views-at-random",
        N_("%(lost)d views seem to be lost at random, at %(places)d places."),
        _LOST_VIEWS,
    )
    SCANNER_JUMP = (
        "scanner-jump",
        N_("Source, turntable or detector moved at view %(view)d, by %(jump_mm).2g mm."),
        N_("Look at what carries source, turntable and detector, and repeat the scan."),
    )
    ANGLE_JITTER = (
        "angle-jitter",
        N_("The angles scatter from view to view, by %(jitter_deg).2g degrees."),
        N_("Look at the encoder and the drive."),
    )
    VIEWS_ELSEWHERE = (
        "each-view-elsewhere",
        N_("Each view stands a little elsewhere: %(shift_mm).2g mm, %(roll_deg).2g degrees."),
    )
    VIEW_GAIN = "view-gain", N_("The views differ in gain or background, so each has its own.")
    MODULE = (
        "module",
        N_(
            "The detector's modules meet at cell %(cell)d with a gap of %(gap_mm)+.2f mm and an angle of "
            "%(angle_deg)+.2f degrees."
        ),
    )
    ARC = (
        "arc",
        N_("The detector's cells lie on an arc with a radius of %(radius_mm).0f mm."),
        N_("State the arc of the detector's drawing in the scanner's constants."),
    )
    UNEVEN_CELLS = (
        "uneven-cells",
        N_("The detector's cells are not equally spaced: they are off by %(uneven_mm).2g mm."),
    )
    ONE_OF = "one-of", N_("%(headline)s This scan does not tell which of these it is.")


class AdjustmentMessage(Message):
    """Faults of a scan, and what was done about them."""

    STAND_INS = (
        "stand-ins",
        N_("%(effects)d effects from view to view were fitted, which cells at other places resemble."),
    )
    FITTED = "fitted", N_("%(headline)s It was fitted.")
    CELLS_LEFT_OUT = "cells-left-out", N_("%(cells)d detector cells without a usable signal were left out.")
    VIEWS_LEFT_OUT = "views-left-out", N_("%(views)d corrupt views were left out.")
    INCONSISTENT_VIEWS = "inconsistent-views", N_("%(views)d views that do not fit the others were left out.")
    OUTLIERS = "outliers", N_("%(share_percent).2f %% of the samples are outliers and lost weight.")
    INTENSITY_AVERAGING = "intensity-averaging", N_("Each cell's averaging of intensities was allowed for.")
    METAL = (
        "metal",
        N_(
            "Metal in the phantom at (x, y) = %(places)s mm of its drawing: the %(share_percent).1f %% of the samples "
            "that see it were left out."
        ),
    )
    PHANTOM_ROWS = "phantom-rows", N_("Of rows %(rows)s, %(used)s show the phantom and were used.")
    ODD_ROWS = (
        "odd-rows",
        N_("Some of the rows %(rows)s, which were named, show another body than the other rows: %(odd)s."),
        N_("Leave out those rows."),
    )
    LOG_NOT_USED = "log-not-used", N_("The log in rows %(rows)s was not used."), "", "%(why)s."
