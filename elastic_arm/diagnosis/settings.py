"""Every threshold of a diagnosis, in one place, with where it comes from.

A number is here if it decides something: what counts as a gap, as a cause, as alike. Tolerances of an optimiser or of a
rank, which change no decision, stand where they are used. The origin of each number follows it:

- a reference or a derivation, where there is one;
- "convention": chosen by the authors as a round number, its effect not studied by itself;
- "clean recordings": far above the largest value that recordings without any effect gave.

What the numbers do together is measured on hidden arms that took no part in choosing them (docs/challenge_results.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from elastic_arm.diagnosis.priors import Priors
from elastic_arm.estimation.residuals import FAILS

MOST_GAIN = 1.5  # of a torque sensor; one that is further off reads another quantity, in all likelihood; convention


@dataclass(frozen=True)
class SplitSettings:
    """Which part of the recordings is fitted and which part judges."""

    held_back: float = 1.0 / 3.0  # share of each recording that judges; convention
    shortest: float = 2.5  # s of either part; five blocks of the block bootstrap, the fewest an interval can rest on
    comparison_rate: float = 50.0  # Hz at which motions are compared; above the motions' own frequencies
    repeated: float = 0.02  # difference over spread below which a motion counts as a repetition; convention
    rows_compared: int = 200  # rows of a validation recording that are looked for in what is fitted; convention
    shared: float = 0.2  # share of them that may be found there; noise repeats no row, so any share would do


@dataclass(frozen=True)
class PreprocessingSettings:
    """Clocks of the two sides, and the common band of all recordings."""

    clock_averaging: float = 0.02  # s; clocks are compared on means over as long; convention
    clock_shift: float = 1e-5  # s over the recording; less changes nothing that can be measured; convention
    clock_certainty: float = 10.0  # standard deviations of each joint's drift; coloured errors need many
    clock_agreement: float = 0.2  # relative difference between joints up to which a drift is common to all; convention
    clock_passes: int = 3  # of estimating and removing; convention
    # Mean square of what is left where a joint sticks over that elsewhere, from which friction's law fails there.
    sticking: float = FAILS
    one_encoder_band: float = 5.0  # Hz; above it the deflection that a single encoder does not show changes the motion
    # Of a band's edge, Hz, times the length of a stretch, s: below, its filters leave too little to judge. They take
    # 4.2 and 3.6 over the edge; half of what the first leaves must be longer than the second.
    narrow_filter: float = 12.0
    difference: float = 1e-3  # of the velocities' spread: equal to differences of positions up to rounding
    rate_tolerance: float = 1.01  # ratio of sample rates that counts as one rate; convention


@dataclass(frozen=True)
class RefitSettings:
    """The calibration of the model's numbers and the sensors."""

    steps: int = 5  # Gauss-Newton steps; the third changes the misfit of 8 % mass errors by less than a thousandth
    step_shares: tuple[float, ...] = (1.0, 0.5, 0.25)  # of a step, tried until one is no worse; convention
    worse: float = 1.01  # ratio of misfits up to which a step is no worse; of noise alone it is known to a few per cent
    passing: float = 1.5  # ratio of misfits up to which a step that leads on may be worse; convention
    approach: float = 0.7  # ratio of what is left of the step from which it leads on; convention
    longest: float = 3.0  # factor by which a secant lengthens a step at most; convention
    # Standard deviations up to which a step is none: what is left of the linearisation's error goes with its square.
    settled: float = 0.3
    # Standard deviations of ordinary priors up to which derivatives are kept: they change by about 2 %; convention.
    same_derivatives: float = 0.25
    same_torques: float = 0.02  # relative change of a known effect up to which they are kept, too; the same 2 %
    most_discount: float = 50.0  # largest factor by which coloured residuals of the widest band are; convention
    beyond_ordinary: float = 3.0  # standard deviations of a prior; 0.3 % of ordinary arms have more
    few: float = (
        0.2  # share of an arm's numbers at that limit from which its description was not commissioned; convention
    )
    # Share of a nuisance parameter's information that has to come from the recording for it to be judged without its
    # prior: of less, the linearisation's own error is the larger part; convention.
    least_known: float = 0.01
    # Factors by which a whole description may be further off than ordinary ones, where one number of it is; convention.
    crude: tuple[float, ...] = (2.0, 4.0, 8.0)
    certain: float = 3.0  # standard deviations by which a sensor is beyond ordinary, and differs from nothing
    stable: float = 0.5  # share of a fault that has to be left beside a law that is likelier; convention
    fault_width: float = 30.0  # of a faulty sensor's prior over an ordinary one's: hardly any prior; convention
    alike: float = 0.1  # relative difference of joints up to which a sensor's fault is common to all; convention
    # Share of the largest information on it from which a joint tells whether a fault is common to all; convention.
    deciding: float = 0.05
    largest_scale: float = 0.6  # relative error of a stiffness; beyond, the description is of another arm; convention
    # Of a torque channel's gain, and change of a known friction in a run: a channel that reads less is of no use.
    largest_ratio: float = 0.75
    # rad/s: the width of the sign function about which dry friction turns over, where none was found for a joint. Of
    # it, the pairs of widths between which it does, and a width within which it does so early or late; convention.
    turning: float = 2e-3
    presliding: tuple[tuple[float, ...], ...] = ((0.25, 1.0), (1.0, 4.0), (1.0,))
    # Half waves over the recording of how a zero that drifts wanders beside its mean rate; convention.
    drift_curves: tuple[int, ...] = (1, 2, 3)

    def presliding_speeds(self, turning: float) -> tuple[tuple[float, ...], ...]:
        """Return the widths of :attr:`presliding`, rad/s, of a joint whose friction was found to turn over so."""
        width = max(turning, self.turning)
        return tuple(tuple(share * width for share in shares) for shares in self.presliding)


@dataclass(frozen=True)
class CandidateSettings:
    """Values of the nonlinear parameters from which the search starts."""

    orders: int = 12  # integer orders of ripple and transmission error tried; convention
    grid: int = 7  # values tried of another parameter, before refinement; convention
    coarse_grid: int = 5  # values tried of each of several parameters; bounds the number of candidates
    reach: float = 0.6  # of half a range: distance of the points that span several parameters of one effect; convention


@dataclass(frozen=True)
class RefinementSettings:
    """The optimisation of nonlinear parameters."""

    evaluations: int = 18  # of one parameter; its optimum is then known to some 0.1 %
    range_factor: float = 3.0  # how far outside its plausible range a nonlinear parameter may be found; convention


@dataclass(frozen=True)
class SearchSettings:
    """The stepwise search, in nats of held-out log-likelihood."""

    # Gain, over the misfit that is left, that a further candidate must bring. Some hundred columns compete, and
    # choosing the best of m is worth about ln m = 6 nats; as much again is margin. Convention near that value.
    least_gain: float = 12.0
    least_share: float = 0.005  # of all the log-likelihood there is to gain; convention
    most_causes: int = 16  # bounds the time
    # Causes of sensors and numbers up to which an exact description is likelier than one that is a little off.
    few_calibrated: int = 3
    starts: int = 2  # single candidates from which the search sets out
    start_ratio: float = 0.3  # least score of another start, as a share of the best hypothesis' score; convention
    shortlist: int = 4  # candidates whose nonlinear parameters are optimised before they are compared
    shortlist_ratio: float = 0.5  # least score on the shortlist, as a share of the best; convention
    by_chance: float = 4.5  # nats that an effect gains by chance at most: three standard deviations; convention
    exchange_passes: int = 2  # of exchanging each selected candidate against all others
    # Nats by which an exchange must improve: a Bayes factor of 20, "strong" in Kass and Raftery (1995).
    exchange_gain: float = 3.0
    simpler_share: float = 0.005  # of a cause's gain, up to which a simpler one in its place may gain less; convention
    refinements: int = 30  # optimisations that one search may spend; bounds the time
    complete: float = 1.3  # misfit up to which next to nothing is left; whitened noise alone gives 1; convention
    bent: float = 3.0  # misfit from which what is unexplained bends nuisance parameters; convention
    unequal: float = 4.0  # times the median misfit of a joint and side, from which each has its own scale; convention
    far_better: float = 0.5  # share of the misfit that a calibration beside one cause may leave; convention
    held: float = 0.99  # share of an effect's squares from which nuisance parameters could stand for it; convention
    ratio_factor: float = 1.2  # how far outside its plausible range a linear ratio may be found; convention
    rivals_compared: float = 40.0  # nats over the misfit within which a rival's refined score can still matter
    rival_slack: float = 1e3  # factor on it before refinement, which may gain as much; convention
    fewest_rivals: int = 2  # rivals compared in any case
    least_odds: float = 1e-4  # odds below which a rival is not kept; a hundredth of the least that is listed


@dataclass(frozen=True)
class SignificanceSettings:
    """When residuals hold more than noise."""

    bands: tuple[float, ...] = (1.0, 0.25, 1.0 / 16.0)  # shares of the band tried: slow effects drown in wide ones
    alpha: float = 1e-3  # probability of a false gap over all residuals and bands (Bonferroni)
    noise_guard: float = 1.12  # factor on the noise power: its estimate is known to a few per cent, and is not white
    obvious: float = 2.0  # ratio to the noise power beyond chance even if it comes from few blocks; convention
    clear: float = 10.0  # excess over its uncertainty from which it is known to a tenth
    # Of the noise: weaker structure is no gap where ordinary sensors are allowed for. The noise of quantised encoders
    # is not white; those of 13 bits leave up to a seventh. Convention.
    practical: float = 0.2
    detected: float = 20.0  # nats from which something is there that no residual shows; clean recordings reach 5


@dataclass(frozen=True)
class ColourSettings:
    """When the noise of the torque sensors is taken as coloured."""

    least_gain: float = 20.0  # nats over white noise; recordings with white noise reach 5
    largest_lack: float = 3.0  # power left over that expected, in any octave and row; noise reaches 2
    largest_peakedness: float = 2.0  # 1 for noise, 1.8 for coarse steps; effects without a column reach 20
    largest_share: float = 0.05  # of the torque of most joints; sensors and currents have 1 % and less


@dataclass(frozen=True)
class JudgementSettings:
    """What a cause, and an explained gap, must satisfy."""

    least_shrink: float = 0.01  # share of the whole gap; less is no cause (docs/contract.md)
    explained: float = 0.1  # share of the excess that may be left whatever it looks like (docs/contract.md)
    place_explained: float = 0.2  # the same of each joint and side's own excess (docs/contract.md)
    main_share: float = 0.1  # of what a cause changes; residuals with less do not judge it; convention
    trace_share: float = 0.1  # of the strongest lack of fit; fainter ones are its images in other residuals
    same_odds: float = 0.05  # of an effect on its other side, from which both sides are named; convention
    least_listed: float = 0.01  # probability of a cause or an alternative that is listed; convention
    level: float = 0.95  # of the intervals and tests of parameters; convention
    bound_clearance: float = 0.01  # of a parameter's distance from no effect to its physical bound; numerical
    large_share: float = 0.3  # of a joint's torque, from which a lag of a sample is a cause all the same; convention
    beyond_range: float = 0.05  # of a searched number's limits, which are round numbers, by which it may pass them
    ordinary_deviations: float = 2.0  # by which an estimate may exceed what every arm has; convention


@dataclass(frozen=True)
class RegimeSettings:
    """What a residual is compared with to name what it follows."""

    orders: tuple[int, ...] = (1, 2, 3, 4)  # of the angles of rotor and wave generator; convention
    weak: float = 0.1  # share of the power below which a regime does not describe a residual; convention
    alike: float = 0.9  # of the best share; the simpler of the regimes that reach it is named; convention
    slow: tuple[float, ...] = (0.1, 0.3)  # of the typical speed; widths of the two low-speed shapes
    motion: float = 3.0  # Hz; spectral lines are looked for above the motion's own frequencies
    start: float = 1.0  # s that count as the start


@dataclass(frozen=True)
class GeneralLawSettings:
    """Laws that no catalogue states, with which those of the causes are compared."""

    # Share of what a cause is worth, in nats, by which a law in its place has to be likelier: those of a real arm's dry
    # friction are by 0.1 to 1.2 %, those of effects that no catalogue has by 7 % and more.
    better: float = 0.02
    # The same of dry friction by a general form of it: real arms' friction changes with angle, speed and time by 0.25.
    refined: float = 1.0 / 3.0
    # Share of a cause's worth that is left beside a law, from which on that law explains something else. Convention.
    taken: float = 0.5
    # Numbers of cubic splines. Conventions: each has its price, so that too many cost a few nats and no truth.
    speeds: int = 10  # over the root of a speed
    times: int = 12  # over the recording
    places: int = 16  # of friction over the angle
    angles: int = 32  # of a torque over the angle
    loads: int = 12
    relaxations: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0, 3.0)  # s; from a cycle of fast motion to a slow one
    sizes: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # Nm; of joints of every kind


@dataclass(frozen=True)
class AgreementSettings:
    """When a cause counts as equal in several recordings."""

    alpha: float = 1e-3  # chi-square probability below which sizes differ by more than chance
    alike: float = 0.02  # of the effect's size; closer values count as equal, however sharp they are; convention
    comparable: float = 0.5  # of the same: values that chance spreads wider cannot be compared; convention


@dataclass(frozen=True)
class ExperimentSettings:
    """The search for the motion that discriminates."""

    decisive: float = SearchSettings.least_gain  # nats from which a recording decides: what a cause must gain
    most_pairs: int = 6  # of effects between which a motion shall discriminate; bounds the time
    seconds: float = 20.0  # length of the motion
    kinds: tuple[tuple[int, int], ...] = ((2, 1), (5, 1), (5, 2), (4, 4))  # harmonics, periods: slow to fast
    drawn: int = 16  # motions of each kind; bounds the time
    amplitudes: tuple[float, ...] = (1.0, 0.3)  # friction shows near standstill, inertia at full speed
    steps: int = 60  # random steps from the best; bounds the time
    stride: float = 0.25  # of the amplitudes, in a step; convention
    centre_stride: float = 0.1  # of the joints' half ranges, in a step; convention
    limit_use: float = 0.98  # of the limits; convention
    neighbours: tuple[float, ...] = (0.6, 1.0, 1.6)  # multiples of a nonlinear parameter that span what a refit can do
    neighbour_distance: float = 0.05  # of the range, the same for parameters on a linear scale
    rate: float = 500.0  # Hz; enough for ripple of the rotor's fourth order at full speed


@dataclass(frozen=True)
class ResamplingSettings:
    """The block bootstrap (Künsch 1989): blocks of the recording are drawn with replacement.

    Each use draws its resamples from its seed: all hypotheses are compared on the same ones (common random numbers),
    and an answer does not depend on those before it.
    """

    draws: int = 4000  # resamples of an interval; its 2.5 % quantile is then known to 0.25 %
    odds_draws: int = 2000  # resamples of a rival's odds; smallest odds above zero 5e-4
    interval: float = 0.95
    significance_seed: int = 0  # of the test of significance
    shrink_seed: int = 1  # of the interval of the shrink
    fall_seed: int = 2  # of the bound of the fall of the whitened squares
    odds_seed: int = 0  # of the odds of rivals


@dataclass(frozen=True)
class DiagnosisSettings:
    """All thresholds of a diagnosis, by the step that uses them.

    Parameters
    ----------
    split, preprocessing, refit, priors
        Data: which part judges, clocks and band, the model's own parameters and how far they may be off.
    candidates, refinement, search
        Selection: what competes, nonlinear parameters, the stepwise search.
    significance, judgement, regimes, general_laws, agreement
        Inference: what is a gap, what is a cause, what a residual follows, with which laws those of causes are
        compared, what agrees.
    experiment
        Design: the next motion.
    resampling
        The block bootstrap and its seeds.
    """

    split: SplitSettings = field(default_factory=SplitSettings)
    preprocessing: PreprocessingSettings = field(default_factory=PreprocessingSettings)
    refit: RefitSettings = field(default_factory=RefitSettings)
    priors: Priors = field(default_factory=Priors)
    candidates: CandidateSettings = field(default_factory=CandidateSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    significance: SignificanceSettings = field(default_factory=SignificanceSettings)
    colour: ColourSettings = field(default_factory=ColourSettings)
    judgement: JudgementSettings = field(default_factory=JudgementSettings)
    regimes: RegimeSettings = field(default_factory=RegimeSettings)
    general_laws: GeneralLawSettings = field(default_factory=GeneralLawSettings)
    agreement: AgreementSettings = field(default_factory=AgreementSettings)
    experiment: ExperimentSettings = field(default_factory=ExperimentSettings)
    resampling: ResamplingSettings = field(default_factory=ResamplingSettings)
