"""Messages on what has moved: since the calibration in use, as a new calibration or a log shows it."""

from sawmill_vocabulary.messages import N_, Message

_WITHIN = N_("Nothing has moved beyond what is allowed: %(moved_mm).3f mm, and %(allowed_mm).2f mm is allowed.")
_COR_AND_NO_TILT = N_("The COR moved %(column_mm)+.2f mm on the detector and the tilt did not.")


class MovementMessage(Message):
    """Messages on a new calibration against the one in use, and on a log; a cause is a part of the others."""

    MOVED = (
        "moved",
        N_("Something has moved: %(moved_mm).2f mm, and %(allowed_mm).2f mm is allowed."),
        "",
        N_("The rays moved %(moved_mm).2f mm RMS. %(details)s"),
    )
    RESCALED = (
        "rescaled",
        N_("Sizes have changed: by %(scale_percent)+.2f %%, and %(allowed_percent).2g %% is allowed."),
        "",
        N_("The scale changed by %(scale_percent)+.3f ± %(spread_percent).2g %%. %(details)s"),
    )
    RESCALED_WITHOUT_BARS = (
        "rescaled-without-error-bars",
        N_("Sizes have changed: by %(scale_percent)+.2f %%, and %(allowed_percent).2g %% is allowed."),
        "",
        N_("The scale changed by %(scale_percent)+.3f %%. %(details)s"),
    )
    TURNED_OVER = (
        "turned-over",
        N_("The log turns the other way than at the calibration in use."),
        N_("Check the drive's direction."),
    )
    FIRST_ANGLE = (
        "first-angle",
        N_("The first angle changed by %(angle_deg)+.3f degrees, and nothing else moved."),
        N_("Check whether the phantom was mounted turned, or the encoder's zero moved."),
    )
    WITHIN = (
        "within",
        _WITHIN,
        "",
        N_("The rays moved %(moved_mm).3f mm RMS, within the %(allowed_mm).2f mm allowed."),
    )
    WITHIN_RESCALED = (
        "within-rescaled",
        _WITHIN,
        "",
        N_(
            "The rays moved %(moved_mm).3f mm RMS, within the %(allowed_mm).2f mm allowed. The scale changed by "
            "%(scale_percent)+.3f ± %(spread_percent).2g %%, as when the phantom dried or swelled, was exchanged, or "
            "the source or what carries the log moved along the beam."
        ),
    )
    UNKNOWN_CAUSE = "unknown-cause", "", N_("Check what carries the log, and the detector.")
    TURNTABLE = (
        "turntable",
        "",
        N_("Check the turntable first. If it is tight, check whether the detector has slid sideways."),
        _COR_AND_NO_TILT,
    )
    TILT = (
        "detector-tilt",
        "",
        N_("Check the detector's mount."),
        N_("The detector's tilt changed by %(tilt_deg)+.3f degrees and nothing else."),
    )
    STAND = (
        "detector-stand",
        "",
        N_("Check the detector's stand."),
        N_("The detector moved %(distance_mm)+.2f mm along the beam and the source did not."),
    )
    SIZE = (
        "phantom-size",
        "",
        N_("Check which phantom was scanned, and measure it. Then check what carries the log along the beam."),
        N_(
            "The source distance changed by %(source_mm)+.2f mm and nothing else, as it does when the phantom's size "
            "is not the stated one: the source shift would be %(shift_mm).0f mm, where the active calibration has "
            "%(shift_before_mm).0f mm, as with a phantom %(by_percent).1f %% %(size)s than its drawing."
        ),
    )
    SOURCE = (
        "source",
        "",
        N_("Check the source's mount."),
        N_("The source moved %(source_mm)+.2f mm along the beam, and nothing else did."),
    )
    KNOCKED = (
        "detector-knocked",
        "",
        N_("Check the detector's mount: the detector was knocked."),
        N_(
            "The COR moved %(column_mm)+.2f mm on the detector and the tilt changed by %(tilt_deg)+.3f degrees: the "
            "detector was knocked."
        ),
    )
    SEVERAL = (
        "several",
        "",
        N_("Find out whether the scanner was moved, or another phantom was scanned."),
        N_(
            "The COR moved %(column_mm)+.2f mm on the detector, the tilt changed by %(tilt_deg)+.3f degrees, the "
            "source distance by %(source_mm)+.2f mm and the distance from source to detector by %(distance_mm)+.2f mm: "
            "the scanner was moved, or another phantom was scanned."
        ),
    )


class LogMessage(Message):
    """Messages of a drift check: what a log shows."""

    MOVED = (
        "log-shows-moved",
        N_("A log shows that something has moved: %(moved_mm).2f mm, and %(allowed_mm).2f mm is allowed."),
        N_("%(action)s Then scan the phantom, and calibrate."),
    )
    RESCALED = (
        "log-shows-rescaled",
        N_("A log shows that sizes have changed: by %(scale_percent)+.2f %%, and %(allowed_percent).2g %% is allowed."),
        N_("%(action)s Then scan the phantom, and calibrate."),
    )
    WITHIN = (
        "log-shows-within",
        N_("A log shows: %(moved_mm).2f mm moved, and %(allowed_mm).2f mm is allowed."),
        N_("Nothing needs to be done."),
    )
    BEYOND_CALIBRATION = (
        "log-shows-beyond-calibration",
        N_(
            "A log shows that the rays are off by %(moved_mm).2f mm: %(allowed_mm).2f mm is allowed, but a calibration "
            "passes only up to %(limit_mm).2f mm."
        ),
        N_("%(action)s Scan the phantom when the line stops next, and calibrate."),
    )
    CALIBRATE_SOON = (
        "log-shows-lost-contrast-within",
        N_("Calibrate soon: knots of 10 mm lose %(loss_percent).0f %% of their contrast."),
        N_("%(action)s Scan the phantom when the line stops next, and calibrate."),
        N_("A log shows: %(moved_mm).2f mm moved, and %(allowed_mm).2f mm is allowed. %(details)s"),
    )
    LOST_CONTRAST = (
        "log-shows-lost-contrast",
        N_("%(headline)s Knots of 10 mm lose %(loss_percent).0f %% of their contrast."),
    )
    NOTHING_MOVED = (
        "log-shows-nothing-moved",
        N_("A log shows that nothing has moved."),
        N_("Nothing needs to be done."),
        N_(
            "Nothing moved that this scan can show: the COR is where it was to %(column_error_mm).2g mm on the "
            "detector, the tilt to %(tilt_error_deg).2g degrees."
        ),
    )
    TURNED_OVER = (
        "log-turned-over",
        N_("The log turned the other way than at the calibration."),
        N_("Check the drive's direction and the angles' sign."),
    )
    MOVED_BEFORE = (
        "moved-before-first-logs",
        N_("The scanner had moved before the first logs: %(offset_mm).2g mm, and %(allowed_mm).2g mm is allowed."),
        N_("Take a new flat field, scan the phantom and calibrate."),
        N_(
            "The first %(looks)d logs after the calibration lie %(offset_mm).2g mm of the rays from it: the scanner "
            "moved before them, or its flat field is wrong."
        ),
    )
    UNCERTAIN = (
        "log-cannot-tell",
        N_("This log cannot tell whether the scanner has moved."),
        N_("Average more rows, or scan a log that is less round or less centred."),
        N_(
            "This scan sees the rays %(moved_mm).2g mm from where they were and places them to %(error_mm).2g mm, so "
            "it cannot tell whether they are within the %(allowed_mm).2g mm that are allowed."
        ),
    )
    SINCE_BASELINE = (
        "since-first-logs",
        "",
        "",
        N_("%(details)s This is counted from the first %(looks)d logs after the calibration."),
    )
    # All sentences are those of the parts: the log's own, and the disturbances of the turn.
    DISTURBED_TURN = ("disturbed-turn",)
    ENCODER = (
        "turn-encoder",
        "",
        "",
        N_(
            "The angles run ahead and behind by %(encoder_deg).2g degrees %(times)s a turn: look at the encoder's "
            "coupling, which is eccentric. This is no drift, and was fitted."
        ),
    )
    BEARING = (
        "turn-bearing",
        "",
        "",
        N_(
            "The log swings across the beam by %(bearing_mm).2g mm %(times)s a turn: look at the turntable's bearing, "
            "which wobbles. This is no drift, and was fitted."
        ),
    )
    TURNTABLE_OR_STOPS = (
        "turntable-or-stops",
        "",
        N_("Look at the turntable and at the detector's stops: either would look like this."),
        _COR_AND_NO_TILT,
    )
    TURNTABLE = "turntable-alone", "", N_("Look at the turntable, not the detector."), _COR_AND_NO_TILT
    TURNTABLE_SIDEWAYS = (
        "turntable-sideways",
        "",
        N_("Look at the turntable."),
        N_(
            "The COR moved %(column_mm)+.2f mm on the detector and the tilt followed as when the turntable moves "
            "sideways."
        ),
    )
    DETECTOR_SLID = (
        "detector-slid",
        "",
        N_("Look at the detector's stops."),
        N_(
            "The COR moved %(column_mm)+.2f mm on the detector and the tilt stayed, as when the detector slides along "
            "itself."
        ),
    )
    MOUNTING = (
        "mounting",
        "",
        N_("Look at the mounting of detector and source."),
        N_(
            "The detector stands otherwise towards the source: COR %(column_mm)+.2f mm, tilt %(tilt_deg)+.3f degrees, "
            "distance %(distance_mm)+.1f mm."
        ),
    )
