from .page import FinishedRun as FinishedRun
from .page import draw_figures as draw_figures
from .page import open_finished as open_finished
from .page import show_run as show_run
from .page import write_inspection as write_inspection
from .page import write_report as write_report
from .page import write_reports as write_reports
