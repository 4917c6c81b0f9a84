"""The colour of torque sensors' noise, from spectra of noise that is known."""

import numpy as np
import pytest

from elastic_arm.estimation.noise_colour import CORNERS, Colour, Periodogram, fit_colour, lacks, pooled, shapes

RATE = 100.0  # Hz
F = np.arange(1, 800) * 0.05
# Two rows share the sensor tau_J, as a link's and a drive's residual do; the second has tau_m, too.
WAYS = {"tau_J": np.tile([[1.0], [1.0]], (len(F), 1, 1)), "tau_m": np.tile([[0.0], [1.0]], (len(F), 1, 1))}


def noise(densities, seed, extra=0.0):
    """Spectra of white noise and of coloured noise of the two sensors."""
    rng = np.random.default_rng(seed)

    def draw(*shape):
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    values = draw(len(F), 2) + extra
    for channel, density in densities.items():
        values = values + WAYS[channel][:, :, 0] * (np.sqrt(density) * draw(len(F)))[:, None]
    return Periodogram(F, values, np.ones((len(F), 2)), WAYS)


def test_white_noise_has_no_colour():
    """Of white noise the colour gains a few nats: no more than its coefficients can by chance."""
    assert max(fit_colour([noise({}, seed)]).gain for seed in range(10)) < 10.0


@pytest.mark.parametrize("name", ["random walk", "pink", "first order"])
def test_the_colour_of_each_channel_is_found(name):
    """Random walk, pink and first-order noise of two sensors come out within 40 % at every octave from 0.1 Hz."""
    true = {"random walk": 3.0 / F**2, "pink": 10.0 / F, "first order": 30.0 / (1 + (F / 10.0) ** 2)}[name]
    fit = fit_colour([noise({"tau_J": true, "tau_m": 0.5 * true}, seed) for seed in range(2)])
    octaves = F[np.searchsorted(F, 0.1 * 2.0 ** np.arange(8))]
    at = np.searchsorted(F, octaves)
    assert fit.gain > 100.0 and fit.lack < 2.0 and fit.peakedness < 1.3
    for channel, scale in (("tau_J", 1.0), ("tau_m", 0.5)):
        found = fit.colour.density(channel, F)[at, 0]
        strong = scale * true[at] > 0.5
        assert np.abs(found / (scale * true[at]) - 1.0)[strong].max() < 0.4, channel


def test_lines_are_no_noise():
    """What stands in some lines alone, as the ripple of a motor does, is peaked far beyond noise."""
    lines = np.where(np.arange(len(F)) % 50 == 0, 40.0, 0.0)[:, None] * [0.0, 1.0]
    assert fit_colour([noise({}, 0, lines)]).peakedness > 3.0


@pytest.mark.parametrize(("share", "peaked"), [(0.02, False), (1.0, True)])
def test_a_frequency_of_which_nothing_is_known_is_no_line(share, peaked):
    """Where a motion can do nearly all, what is left is divided by a small number, and is no peak of the noise."""
    one = noise({}, 0)
    one.values[600, 1], one.share[600, 1] = 14.0, share
    assert (fit_colour([one]).peakedness > 2.0) == peaked


def test_more_than_noise_is_found_at_its_row_in_any_octave():
    """Five times the power of the noise in one octave of one row is lack there; the other row has none."""
    colour = Colour({"tau_J": np.eye(3 + len(CORNERS))[:1], "tau_m": np.eye(3 + len(CORNERS))[:1]}, 0.05)
    more = noise({"tau_J": np.ones(len(F)), "tau_m": np.where((F > 1.0) & (F < 2.0), 13.0, 1.0)}, 0)
    first, second = lacks([more], colour)
    assert first < 2.0 and second > 3.0


def test_below_the_lowest_frequency_the_density_stays():
    """No density grows without bound towards zero frequency."""
    colour = Colour({"tau_J": np.eye(3 + len(CORNERS))[2:3]}, 0.1)
    assert colour.density("tau_J", np.array([0.0, 0.05, 0.1])).ravel() == pytest.approx([100.0] * 3)
    assert shapes(F).min() > 0.0


def test_the_noise_of_a_fine_sensor_is_pooled_beside_its_white_noise():
    """A sensor ten times finer than its neighbours is given a hundredth of their noise where none of it was found."""
    coefficients = np.zeros((3, 3 + len(CORNERS)))
    coefficients[:2, 2] = 4.0
    (one,) = pooled([Colour({"tau_J": coefficients}, 0.1)], {"tau_J": np.array([1.0, 1.0, 0.01])}, 5.0)
    assert one.coefficients["tau_J"][:, 2] == pytest.approx([4.0, 4.0, 0.04])


def test_what_is_far_beyond_the_noise_of_its_kind_is_no_noise():
    """Of a thousand times the power of its neighbours' noise, white and coloured, twenty times are a sensor's."""
    coefficients = np.zeros((3, 3 + len(CORNERS)))
    coefficients[:, 0] = 1000.0, 1.0, 1.0
    (one,) = pooled([Colour({"tau_J": coefficients}, 0.1)], {"tau_J": np.ones(3)}, 5.0)
    assert one.coefficients["tau_J"][:, 0] == pytest.approx([40.0, 1.0, 1.0])


def test_one_noisy_sensor_does_not_make_its_neighbours_noisy():
    """What is found at one sensor of three, such as what a model lacks there, is no noise of the other two."""
    coefficients = np.zeros((3, 3 + len(CORNERS)))
    coefficients[0, 0] = 10.0
    (one,) = pooled([Colour({"tau_J": coefficients}, 0.1)], {"tau_J": np.ones(3)}, 5.0)
    assert one.coefficients["tau_J"][:, 0] == pytest.approx([10.0, 0.0, 0.0])


def test_joints_without_the_channel_have_no_noise_and_change_that_of_no_other():
    """A joint that has no torque sensor has a white noise of null: the others are pooled without it."""
    coefficients = np.zeros((3, 3 + len(CORNERS)))
    coefficients[:2, 2] = 4.0
    (one,) = pooled([Colour({"tau_J": coefficients}, 0.1)], {"tau_J": np.array([1.0, 1.0, 0.0])}, 5.0)
    assert one.coefficients["tau_J"][:, 2] == pytest.approx([4.0, 4.0, 0.0])


@pytest.mark.parametrize("rows", [(1.0, -1.0), (1.0, 0.5), (0.0, 1.0)])
def test_what_is_far_above_any_noise_is_no_colour_of_a_sensor(rows):
    """Residuals whose squares are 1e20 times the white noise's, as of angles in degrees, end the fit without one."""
    one = noise({}, 0, 1e10 * np.array(rows) / np.sqrt(F)[:, None])
    fit = fit_colour([Periodogram(one.f, one.values, one.share, {"tau_J": WAYS["tau_J"]})])
    assert fit.gain == -np.inf
    assert not fit.colour.coefficients["tau_J"].any()
