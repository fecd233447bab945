"""The experiments, in the order of the page."""

from paper import methods, misspecification, objectives, optimisers, pairs, sparse, table_1
from paper.experiment import Experiment

EXPERIMENTS: tuple[Experiment, ...] = (
    table_1.EXPERIMENT,
    pairs.EXPERIMENT,
    misspecification.EXPERIMENT,
    sparse.EXPERIMENT,
    objectives.EXPERIMENT,
    optimisers.EXPERIMENT,
    methods.EXPERIMENT,
)
