"""Messages on a file that is read as a scan: what was read in another way than it is stored, and what it lacks."""

from sawmill_vocabulary.messages import N_, Message

_LOWER = N_("Lower the tube's current or the exposure until air stays below it. Then take flat fields and scan again.")


class ReadingMessage(Message):
    """Remarks on the contents of a file."""

    NO_DARKS = "no-darks", N_("There are no dark fields: the detector's offset was taken as zero.")
    DARKS_ZERO = "darks-zero", N_("All dark fields are 0: the detector's offset was taken as zero.")
    FLATS_LEFT_OUT = (
        "flats-left-out",
        N_("%(odd)d of %(fields)d flat fields differ from the others and were left out: flat field %(numbers)s."),
        N_("Take flat fields with the beam on and nothing in it."),
    )
    DARKS_LEFT_OUT = (
        "darks-left-out",
        N_("%(odd)d of %(fields)d dark fields differ from the others and were left out: dark field %(numbers)s."),
        N_("Take dark fields with the beam off."),
    )
    FLATS_DIFFER = (
        "flats-differ",
        N_("The %(fields)d flat fields differ, and it is not clear which of them are wrong: all were used."),
        N_("Take flat fields with the beam on and nothing in it."),
    )
    DARKS_DIFFER = (
        "darks-differ",
        N_("The %(fields)d dark fields differ, and it is not clear which of them are wrong: all were used."),
        N_("Take dark fields with the beam off."),
    )
    MATLAB_AXES = "matlab-axes", N_("The arrays were transposed: MATLAB stores the last axis first.")
    AXES_ORDERED = "axes-ordered", N_("The axes were read in the order %(axes)s, as was asked for.")
    AXES_STATED = "axes-stated", N_("The axes were read in the order %(axes)s, as the file states it.")
    AXES_DOUBTED = (
        "axes-doubted",
        N_("The file was read as %(views)d views of %(rows)d rows and %(cells)d cells: are these the axes?"),
        N_("If they are not, give their order: %(option)s."),
    )
    UNPACKED = (
        "unpacked",
        N_("Values of %(path)s were unpacked by %(names)s: %(scale)s times the stored number, plus %(offset)s."),
    )
    FLATS_BY_NAME = "flats-by-name", N_("The flat fields were taken from %(arrays)s, by name and shape.")
    DARKS_BY_NAME = "darks-by-name", N_("The dark fields were taken from %(arrays)s, by name and shape.")
    DARKS_UNCLEAR = (
        "darks-unclear",
        N_(
            "No dark fields were used, because it is not clear which of %(arrays)s they are: the detector's offset was "
            "taken as zero."
        ),
        N_("Name the right array darks, or give its file as the dark fields."),
    )
    RADIANS_ASKED = (
        "radians-asked",
        N_("The angles lie between %(least_deg).4g and %(most_deg).4g degrees: are these radians or turns?"),
        N_("Then state the unit rad in the file, or give degrees."),
    )
    DEGREES_ASKED = (
        "degrees-asked",
        N_("The angles lie between %(least_rad).4g and %(most_rad).4g radians: are these degrees?"),
        N_("Then state the unit deg in the file."),
    )
    BINNED = (
        "binned",
        N_(
            "%(path)s is %(pixel_mm)s mm and %(binning_path)s is %(binning)d: the distance between cells is "
            "%(pitch_mm)s mm, unless %(pixel_mm)s mm is given for it."
        ),
    )
    PITCH_ASKED = (
        "pitch-asked",
        N_(
            "The distance between cells is %(pitch_mm).4g mm; detectors have at most %(largest_mm)d mm: is the unit "
            "right?"
        ),
    )
    SINGLE_PAGE = "single-page", N_("The single page was read as the sinogram of one row.")
    ANGLES_GIVEN = "angles-given", N_("The angles given were used: %(headline)s.")
    ANGLES_GIVEN_BUT = "angles-given-but", N_("The angles given were used, but %(why)s.")
    ANGLES_UNNAMED = "angles-unnamed", N_("no name states meaning and unit of %(arrays)s")
    ANGLES_WITHOUT_UNIT = "angles-without-unit", N_("the angles in %(path)s have no units attribute")
    ANGLES_OF_OTHER_UNIT = (
        "angles-of-other-unit",
        N_("the unit '%(unit)s' of the angles in %(path)s is not a known unit of angle"),
    )
    ANGLES_OF_OTHER_NUMBER = (
        "angles-of-other-number",
        N_("%(path)s has %(angles)d angles for %(images)d images, of which %(views)d are views"),
    )
    UNUSED_VALUES = "unused-values", N_("No name states meaning and unit of %(arrays)s: not used.")
    LENGTH_IGNORED = "length-ignored", N_("%(path)s was ignored: %(headline)s.")
    LENGTH_OF_SEVERAL = "length-of-several", N_("it has %(values)d values instead of one")
    LENGTH_WITHOUT_UNIT = "length-without-unit", N_("it has no units attribute")
    LENGTH_OF_OTHER_UNIT = "length-of-other-unit", N_("its unit '%(unit)s' is not a known unit of length")
    BINNING_UNCLEAR = "binning-unclear", N_("the binning in %(path)s is no single whole number")
    LENGTH_STATES_NOTHING = "length-states-nothing", N_("it is %(length_mm)s mm, which states no distance")
    MODULES_IGNORED = "modules-ignored", N_("The detector's modules in %(path)s were ignored: %(why)s.")
    NO_IMAGE_KEY = "no-image-key", N_("%(path)s is missing: every image is a view.")
    INVALID_IMAGES = "invalid-images", N_("%(images)d images marked invalid (image_key 3) were left out.")
    ALIGNMENT_IMAGES = "alignment-images", N_("%(images)d alignment images (%(key)s -1) were left out.")
    OTHER_FILES = "other-files", N_("%(files)d files that are no TIFFs were ignored (%(names)s).")
    SUBFOLDERS = "subfolders", N_("%(folders)d subfolders were not looked into (%(names)s).")
    FEWER_ROWS = "fewer-rows", N_("Views of fewer than %(rows)d rows were read as lacking rows at their end.")
    NAMES_OF_SEVERAL_FORMS = (
        "names-of-several-forms",
        N_(
            "The files' names have %(forms)d forms (%(names)s): all were taken as views, in the order of their numbers."
        ),
    )
    NUMBERS_LEFT_OUT = (
        "numbers-left-out",
        N_(
            "The numbers in the files' names leave out %(numbers)s (%(missing)d of %(total)d): each file was taken as "
            "the next view, and angles as START:STEP do not fit from there on."
        ),
    )
    NUMBERS_REPEATED = (
        "numbers-repeated",
        N_("%(repeated)d numbers in the files' names are there twice (%(names)s): each file was taken as a view."),
    )
    IMAGES_LEFT_OUT = (
        "images-left-out",
        N_("%(images)d images were left out, because they are not named as the views are (%(names)s)."),
        N_("If they are views, name them as the other views; call flat and dark fields flat and dark."),
    )
    SORTED_BY_NUMBER = (
        "sorted-by-number",
        N_("The views were put in order by number %(position)d of their names (%(names)s)."),
        N_("Check that the angles are in this order."),
    )
    NO_WHOLE_TURN = (
        "no-whole-turn",
        N_("%(views)d views in steps of %(step_deg)s degrees cover %(covered_deg)s degrees, which are no whole turns."),
        N_("Check the step and the number of views."),
    )
    PIXELS_UNPACKED = (
        "pixels-unpacked",
        N_("The images' values were unpacked by %(names)s: %(scale)s times the stored number, plus %(offset)s."),
    )
    WHITE_IS_ZERO = (
        "white-is-zero",
        N_("Min is white (PhotometricInterpretation 0): values are %(largest)d less the number."),
    )
    WHITE_IS_ZERO_UNUSED = (
        "white-is-zero-unused",
        N_("Min is white (PhotometricInterpretation 0) was ignored: only unsigned integers can be inverted."),
    )
    ORIENTATION = "orientation", N_("The images were flipped as their Orientation %(orientation)d states.")


class PreparingMessage(Message):
    """Steps by which a scan became line integrals."""

    LINE_INTEGRALS = "line-integrals", N_("Counts became line integrals by -ln((counts - dark) / (flat - dark)).")
    NO_SIGNAL = "no-signal", N_("%(samples)d samples without signal were cut off at a line integral of 13.8.")
    DEAD_CELLS = "dead-cells", N_("%(cells)d dead detector cells were bridged from their neighbours.")
    FAULTY_CELLS = (
        "faulty-cells",
        N_("%(cells)d dead or hot detector cells in %(rows)d rows were bridged from their neighbours."),
    )
    SATURATED_FLATS_BRIDGED = (
        "saturated-flats-bridged",
        N_(
            "Saturation: the flat fields of %(saturated)d of %(cells)d detector cells have the largest value, "
            "%(largest).0f. They were bridged from their neighbours."
        ),
        _LOWER,
    )
    SATURATED_FLATS = (
        "saturated-flats",
        N_(
            "Saturation: the flat fields of %(saturated)d of %(cells)d detector cells have the largest value, "
            "%(largest).0f. They are too many to be left out: their line integrals are too small."
        ),
        _LOWER,
    )
    SATURATED_SAMPLES = (
        "saturated-samples",
        N_(
            "Saturation: %(samples)d samples of the scan have the largest value, %(largest).0f. Their line integrals "
            "are too large."
        ),
        _LOWER,
    )
    VIEWS_LEFT_OUT = (
        "views-left-out-of-scan",
        N_(
            "%(number)d of %(total)d views were left out: views %(views)s have no signal, or a signal that no other "
            "view has."
        ),
        N_("Check whether the detector sent all views."),
    )
    AIR_LEVEL = (
        "air-level",
        N_(
            "The air level in at least %(cells)d cells at the detector's ends was taken out of %(rows)d rows: "
            "%(level).2g in the mean."
        ),
    )
    AIR_OF_VIEWS = (
        "air-of-views",
        N_("In %(rows)d rows it was taken out view by view, where it varied by %(deviation).2g (standard deviation)."),
    )
    ROWS_WITHOUT_AIR = ("rows-without-air", N_("%(rows)d rows without air at the detector's ends keep their level."))
    RINGS_REMOVED = (
        "rings-removed",
        N_("Rings were removed by sorting: stripes were %(before).2g and are %(after).2g (median of the rows)."),
        "",
        N_("Vo, Atwood and Drakopoulos 2018, algorithm 3, %(window)d cells."),
    )
    RINGS_VISIBLE = (
        "rings-visible",
        N_("Unequal cells leave stripes of %(before).2g in %(rows)d rows, seen as rings; rings=sorting removes them."),
    )
    MEAN_OF_ROWS = (
        "mean-of-rows",
        N_("It came as the mean of the line integrals of %(rows)d rows, without standard deviations."),
    )
    MEAN_WITH_DEVIATIONS = (
        "mean-with-deviations",
        N_("It came as the mean of the line integrals of %(rows)d rows, with their standard deviations."),
    )
    NO_RAY_MASKED = "no-ray-masked", N_("No ray of it was masked.")
    RAYS_MASKED = (
        "rays-masked",
        N_("%(masked)d of %(samples)d rays were masked, and interpolated along the detector."),
    )
    ROWS_ALIGNED = (
        "rows-aligned",
        N_(
            "Views were aligned by their %(method)s: rows %(first)d:%(last)d of %(rows)d are in enough views, "
            "%(complete)d of them in all. %(moved)d of %(views)d views moved by %(least).3g to %(most).3g rows, "
            "standard deviation %(deviation).2g."
        ),
    )
    ROWS_ALIGNED_WHOLE = (
        "rows-aligned-whole",
        N_(
            "Views were aligned by their %(method)s: rows %(first)d:%(last)d of %(rows)d are in enough views, "
            "%(complete)d of them in all. %(moved)d of %(views)d views moved by %(least).0f to %(most).0f whole rows, "
            "standard deviation %(deviation).2g."
        ),
    )
    VIEWS_RESAMPLED = "views-resampled", N_("%(views)d views were resampled by cubic convolution.")
