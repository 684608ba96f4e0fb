# SPDX-License-Identifier: BSD-3-Clause
"""Identification of a piezo-actuated stage: experiments, estimators, node, offline commands."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_identification.axes.axes_response import AxesResponse, read_axes_response
    from piezo_identification.axes.identify_axes import identify_several_axes
    from piezo_identification.axes.predict_axes import AxesPrediction, predict_several_axes
    from piezo_identification.diagnosis.diagnose import diagnose
    from piezo_identification.diagnosis.experiment_design.decide import decide
    from piezo_identification.diagnosis.experiment_design.propose import (
        alternatives_of_files,
        propose,
    )
    from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
    from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
    from piezo_identification.estimators.estimate import Estimate
    from piezo_identification.estimators.frequency_response.response_file import (
        FrequencyResponse,
        read_frequency_response,
    )
    from piezo_identification.estimators.frequency_response.response_fit import (
        ResponseOrder,
        estimate_from_response,
    )
    from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
    from piezo_identification.estimators.hysteresis.density_fit import estimate_density
    from piezo_identification.experiments.catalogue import (
        Experiment,
        StageLimits,
        named_experiment,
    )
    from piezo_identification.identification.identify import identify
    from piezo_identification.identification.progress import IdentificationCancelled
    from piezo_identification.monitoring.model_monitor import ModelMonitor
    from piezo_identification.prediction.prediction import Prediction, predict
    from piezo_identification.prediction.prediction_errors import unseen_errors

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "AxesPrediction", "AxesResponse", "DensityEstimate", "Estimate", "Experiment",
    "FrequencyResponse", "IdentificationCancelled", "ModelMonitor", "Prediction", "ResponseOrder",
    "StageLimits", "alternatives_of_files", "decide", "diagnose", "estimate_creep",
    "estimate_density", "estimate_dynamics", "estimate_from_response", "identify",
    "identify_several_axes", "named_experiment", "predict", "predict_several_axes", "propose",
    "read_axes_response", "read_frequency_response",
    "unseen_errors",
]
