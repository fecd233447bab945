"""Contains all the data models used in inputs/outputs"""

from .activate import Activate
from .activation import Activation
from .adjustment import Adjustment
from .agreement import Agreement
from .air_correction import AirCorrection
from .alarm import Alarm
from .alarm_kind import AlarmKind
from .alarm_limits import AlarmLimits
from .alarm_list import AlarmList
from .alpha_rule import AlphaRule
from .audit_action import AuditAction
from .audit_entry import AuditEntry
from .audit_entry_detail_type_0 import AuditEntryDetailType0
from .audit_entry_page import AuditEntryPage
from .axis import Axis
from .bits import Bits
from .calibration_ask import CalibrationAsk
from .calibration_limits import CalibrationLimits
from .calibration_links import CalibrationLinks
from .calibration_method import CalibrationMethod
from .calibration_options import CalibrationOptions
from .calibration_page import CalibrationPage
from .calibration_status import CalibrationStatus
from .calibration_succeeded import CalibrationSucceeded
from .calibration_unfinished import CalibrationUnfinished
from .color_map import ColorMap
from .column_and_tilt import ColumnAndTilt
from .comparison import Comparison
from .data_kind import DataKind
from .delivery import Delivery
from .delivery_page import DeliveryPage
from .delivery_state import DeliveryState
from .detector_deviation import DetectorDeviation
from .detector_geometry import DetectorGeometry
from .disc import Disc
from .disturbed_part import DisturbedPart
from .drift import Drift
from .drift_ask import DriftAsk
from .drift_baseline import DriftBaseline
from .drift_finding import DriftFinding
from .drift_finding_kind import DriftFindingKind
from .drift_links import DriftLinks
from .drift_method import DriftMethod
from .drift_options import DriftOptions
from .drift_page import DriftPage
from .drift_reference import DriftReference
from .drift_result import DriftResult
from .event import Event
from .event_detail_type_0 import EventDetailType0
from .event_kind import EventKind
from .failure import Failure
from .failure_kind import FailureKind
from .faulty_cells import FaultyCells
from .field_problem import FieldProblem
from .file_part import FilePart
from .file_verdict import FileVerdict
from .filter_name import FilterName
from .given_calibration_options import GivenCalibrationOptions
from .given_theta import GivenTheta
from .given_theta_bounds import GivenThetaBounds
from .going import Going
from .handedness import Handedness
from .health import Health
from .history_entry import HistoryEntry
from .history_entry_page import HistoryEntryPage
from .history_kind import HistoryKind
from .hypothesis import Hypothesis
from .inspected_file import InspectedFile
from .inspected_reading import InspectedReading
from .inspection import Inspection
from .inspection_links import InspectionLinks
from .inspection_page import InspectionPage
from .inspection_result import InspectionResult
from .job import Job
from .job_history import JobHistory
from .job_kind import JobKind
from .job_page import JobPage
from .job_state import JobState
from .key import Key
from .key_ask import KeyAsk
from .key_rotation import KeyRotation
from .keys import Keys
from .kind_preview import KindPreview
from .known_baseline import KnownBaseline
from .list_color_maps_response_list_color_maps import ListColorMapsResponseListColorMaps
from .measurement import Measurement
from .measurement_kind import MeasurementKind
from .measurement_page import MeasurementPage
from .measurements_ask import MeasurementsAsk
from .metal_handling import MetalHandling
from .metal_report import MetalReport
from .metal_treatment import MetalTreatment
from .method_report import MethodReport
from .missing_part import MissingPart
from .moved_body import MovedBody
from .new_key import NewKey
from .new_webhook import NewWebhook
from .on_pass import OnPass
from .own_key import OwnKey
from .paper_correlation import PaperCorrelation
from .paper_objective import PaperObjective
from .paper_options import PaperOptions
from .paper_stop import PaperStop
from .phantom_ask import PhantomAsk
from .phantom_drawing import PhantomDrawing
from .phantom_state import PhantomState
from .place import Place
from .plan import Plan
from .plan_ask import PlanAsk
from .plan_asked import PlanAsked
from .plan_links import PlanLinks
from .plan_page import PlanPage
from .plan_result import PlanResult
from .polygon import Polygon
from .pooled_drift import PooledDrift
from .predicted_ray_error import PredictedRayError
from .preference import Preference
from .priority import Priority
from .problem import Problem
from .problem_type import ProblemType
from .problem_types import ProblemTypes
from .progress import Progress
from .readiness import Readiness
from .reconstruction import Reconstruction
from .reconstruction_ask import ReconstructionAsk
from .reconstruction_asked import ReconstructionAsked
from .reconstruction_links import ReconstructionLinks
from .reconstruction_method import ReconstructionMethod
from .reconstruction_page import ReconstructionPage
from .reconstruction_result import ReconstructionResult
from .removed import Removed
from .reported_source_frame import ReportedSourceFrame
from .residual import Residual
from .retention import Retention
from .retention_ask import RetentionAsk
from .retention_kind import RetentionKind
from .retention_preview import RetentionPreview
from .retention_rules import RetentionRules
from .ring_removal import RingRemoval
from .rotation import Rotation
from .row_alignment import RowAlignment
from .scan import Scan
from .scan_form import ScanForm
from .scan_page import ScanPage
from .scan_shape import ScanShape
from .scan_state import ScanState
from .scanner_ask import ScannerAsk
from .scanner_constants import ScannerConstants
from .scanner_drift import ScannerDrift
from .schedule import Schedule
from .schedule_ask import ScheduleAsk
from .schedule_kind import ScheduleKind
from .schedule_outcome import ScheduleOutcome
from .schedule_page import SchedulePage
from .schedule_run import ScheduleRun
from .scope import Scope
from .search import Search
from .second_witness import SecondWitness
from .shown import Shown
from .size_measurement import SizeMeasurement
from .source_frame_deviation import SourceFrameDeviation
from .standard_deviation import StandardDeviation
from .staying import Staying
from .stays_because import StaysBecause
from .stored_phantom import StoredPhantom
from .stored_phantom_page import StoredPhantomPage
from .stored_scanner import StoredScanner
from .stored_scanner_page import StoredScannerPage
from .theta import Theta
from .theta_bounds import ThetaBounds
from .theta_deviation import ThetaDeviation
from .timing import Timing
from .tolerances import Tolerances
from .turn_disturbance import TurnDisturbance
from .unfinished_state import UnfinishedState
from .upload import Upload
from .upload_ask import UploadAsk
from .upload_state import UploadState
from .verdict import Verdict
from .view_angles import ViewAngles
from .webhook import Webhook
from .webhook_ask import WebhookAsk
from .webhook_rotation import WebhookRotation
from .webhook_state import WebhookState
from .webhook_test import WebhookTest
from .webhooks import Webhooks
from .weighting import Weighting
from .witness_taken import WitnessTaken

__all__ = (
    "Activate",
    "Activation",
    "Adjustment",
    "Agreement",
    "AirCorrection",
    "Alarm",
    "AlarmKind",
    "AlarmLimits",
    "AlarmList",
    "AlphaRule",
    "AuditAction",
    "AuditEntry",
    "AuditEntryDetailType0",
    "AuditEntryPage",
    "Axis",
    "Bits",
    "CalibrationAsk",
    "CalibrationLimits",
    "CalibrationLinks",
    "CalibrationMethod",
    "CalibrationOptions",
    "CalibrationPage",
    "CalibrationStatus",
    "CalibrationSucceeded",
    "CalibrationUnfinished",
    "ColorMap",
    "ColumnAndTilt",
    "Comparison",
    "DataKind",
    "Delivery",
    "DeliveryPage",
    "DeliveryState",
    "DetectorDeviation",
    "DetectorGeometry",
    "Disc",
    "DisturbedPart",
    "Drift",
    "DriftAsk",
    "DriftBaseline",
    "DriftFinding",
    "DriftFindingKind",
    "DriftLinks",
    "DriftMethod",
    "DriftOptions",
    "DriftPage",
    "DriftReference",
    "DriftResult",
    "Event",
    "EventDetailType0",
    "EventKind",
    "Failure",
    "FailureKind",
    "FaultyCells",
    "FieldProblem",
    "FilePart",
    "FileVerdict",
    "FilterName",
    "GivenCalibrationOptions",
    "GivenTheta",
    "GivenThetaBounds",
    "Going",
    "Handedness",
    "Health",
    "HistoryEntry",
    "HistoryEntryPage",
    "HistoryKind",
    "Hypothesis",
    "InspectedFile",
    "InspectedReading",
    "Inspection",
    "InspectionLinks",
    "InspectionPage",
    "InspectionResult",
    "Job",
    "JobHistory",
    "JobKind",
    "JobPage",
    "JobState",
    "Key",
    "KeyAsk",
    "KeyRotation",
    "Keys",
    "KindPreview",
    "KnownBaseline",
    "ListColorMapsResponseListColorMaps",
    "Measurement",
    "MeasurementKind",
    "MeasurementPage",
    "MeasurementsAsk",
    "MetalHandling",
    "MetalReport",
    "MetalTreatment",
    "MethodReport",
    "MissingPart",
    "MovedBody",
    "NewKey",
    "NewWebhook",
    "OnPass",
    "OwnKey",
    "PaperCorrelation",
    "PaperObjective",
    "PaperOptions",
    "PaperStop",
    "PhantomAsk",
    "PhantomDrawing",
    "PhantomState",
    "Place",
    "Plan",
    "PlanAsk",
    "PlanAsked",
    "PlanLinks",
    "PlanPage",
    "PlanResult",
    "Polygon",
    "PooledDrift",
    "PredictedRayError",
    "Preference",
    "Priority",
    "Problem",
    "ProblemType",
    "ProblemTypes",
    "Progress",
    "Readiness",
    "Reconstruction",
    "ReconstructionAsk",
    "ReconstructionAsked",
    "ReconstructionLinks",
    "ReconstructionMethod",
    "ReconstructionPage",
    "ReconstructionResult",
    "Removed",
    "ReportedSourceFrame",
    "Residual",
    "Retention",
    "RetentionAsk",
    "RetentionKind",
    "RetentionPreview",
    "RetentionRules",
    "RingRemoval",
    "Rotation",
    "RowAlignment",
    "Scan",
    "ScanForm",
    "ScannerAsk",
    "ScannerConstants",
    "ScannerDrift",
    "ScanPage",
    "ScanShape",
    "ScanState",
    "Schedule",
    "ScheduleAsk",
    "ScheduleKind",
    "ScheduleOutcome",
    "SchedulePage",
    "ScheduleRun",
    "Scope",
    "Search",
    "SecondWitness",
    "Shown",
    "SizeMeasurement",
    "SourceFrameDeviation",
    "StandardDeviation",
    "Staying",
    "StaysBecause",
    "StoredPhantom",
    "StoredPhantomPage",
    "StoredScanner",
    "StoredScannerPage",
    "Theta",
    "ThetaBounds",
    "ThetaDeviation",
    "Timing",
    "Tolerances",
    "TurnDisturbance",
    "UnfinishedState",
    "Upload",
    "UploadAsk",
    "UploadState",
    "Verdict",
    "ViewAngles",
    "Webhook",
    "WebhookAsk",
    "WebhookRotation",
    "Webhooks",
    "WebhookState",
    "WebhookTest",
    "Weighting",
    "WitnessTaken",
)
