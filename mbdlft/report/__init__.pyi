from .page import model_report as model_report
