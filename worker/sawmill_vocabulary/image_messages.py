"""Messages on a reconstruction: how far an image is from its data, and what was excluded as the cause."""

from sawmill_vocabulary.messages import N_, Message


class ImageMessage(Message):
    """Remarks on the data and the fit of a reconstruction."""

    MISSES_DATA = ("image-misses-data", N_("The image misses the data by %(times).2g times their noise. %(headline)s"))
    FILTERED_MISSES_DATA = (
        "filtered-image-misses-data",
        N_(
            "The image misses the data by more than %(percent).0f %% of them and %(times).0f times their noise, which "
            "filtering alone does not. %(headline)s"
        ),
    )
    IN_FEW_VIEWS = (
        "misfit-in-few-views",
        N_("%(percent).0f %% of that is in views %(views)s, which do not fit the others."),
        N_("Look at these views, and leave them out with their angles."),
    )
    DISPLACED = (
        "misfit-by-displaced-views",
        N_(
            "Shifts of single views along the detector explain %(percent).0f %% of that: the geometry is wrong, the "
            "object moved during the scan, or it lies partly outside the field."
        ),
        N_("Check the geometry, and whether the object stood firm."),
    )
    NOT_DISPLACED = (
        "misfit-without-displaced-views",
        N_(
            "Shifts of single views along the detector explain no more than %(percent).0f %% of that, and no few views "
            "hold most of it. Metal, beam hardening, scattered radiation, blur, rows far from the middle of the beam, "
            "or views in another order than their angles can be the cause."
        ),
        N_("Check the order of the views and their angles first."),
    )
    AIR_NOT_AT_ZERO = (
        "air-not-at-zero",
        N_("The air stands at %(level).3g and not at 0."),
        N_("Take the background out first."),
    )
    AIR_IN_SLICES = (
        "air-in-slices",
        N_("The air does not stand at 0, and that is in the slices."),
        N_("Prepare the scan with air=background."),
    )
    METAL_LEFT = (
        "metal-left",
        N_(
            "Metal covers more than %(percent).0f %% of the rays of %(slices)d slices: they were reconstructed from "
            "all rays, and streaks are to be expected."
        ),
    )
    KNOTS_FADE = (
        "knots-fade",
        N_(
            "With these views and this noise, a knot of 10 mm keeps %(contrast_10_mm_percent).0f %% of its contrast, "
            "and one of 20 mm %(contrast_20_mm_percent).0f %%."
        ),
        N_("For smaller knots take more views, or a longer exposure."),
    )
    VIEWS_STAND_ELSEWHERE = (
        "views-stand-elsewhere",
        N_("Each view stands a little elsewhere: %(shift_mm).1f mm, %(roll_deg).1f degrees."),
        "",
        N_("The log itself shows where it stands in each view, and the image is made with that."),
    )
    POSES_NOT_FOUND = (
        "poses-not-found",
        N_("How the log stands in each view was not found: this needs %(views)d views, and air on both sides of it."),
    )
    GEOMETRY_LOSES_CONTRAST = (
        "geometry-loses-contrast",
        N_("By the calibration's bound, knots of 10 mm may lose up to %(loss_percent).0f %% of their contrast."),
    )
