# SPDX-License-Identifier: BSD-3-Clause
"""The page on published references, with the table of the study."""

from collections.abc import Sequence

from piezo_studies.published_reference.by_preview import (
    AMPLITUDE_UM,
    BAND_HZ,
    DURATION_S,
    Followed,
    table,
)

INTRODUCTION = """\
# Follow what another node publishes

Written by `make published-reference`; do not edit.

A joystick, another controller or a vision loop can generate the reference while the stage follows
it. It publishes `piezo_interfaces/ReferenceSamples` on the topic `reference` of the stage's
namespace, and a goal of `controller/track` names the kind `topic`:

```
ros2 action send_goal /controller/track piezo_interfaces/action/Track "{{
  reference: {{kind: topic, frequency_hz: [100.0], amplitude_um: [20.0]}},
  model: runs/first/model.json, mode: composite, duration_s: 60.0, directory: runs/first}}"
```

| field | meaning |
|---|---|
| `frequency_hz`, `amplitude_um` of the goal | The highest frequency and the largest \
peak-to-peak amplitude of the published reference. A reference within these limits is followed \
exactly: by Bernstein's inequality it never exceeds the bounds of speed and acceleration that \
follow from them |
| `centre_um` of the goal | Added to the published values, which then lie within half of the \
amplitude around it. With 0, the published values lie anywhere, within one amplitude |
| `first_sample` | Number of the first value of the message, counted without gaps. A repeated \
value counts once, and a straight line bridges missing values. Zero starts again |
| `sample_period_s` | Distance of the values, a whole multiple of the sample clock's period; 0 \
for that period. Straight lines join slow values |
| `preview_samples` | Number of samples of the clock by which the last value lies ahead of the \
publisher's present. The first message of a run decides |
| mode | `feedforward` or `composite`. The feedforward is streamed, and the node answers the \
feedback, as for every streamed reference |

**Delay.** The stage follows the published values after a constant delay: 20 ms for late messages,
and the length of two messages. The error of a run is relative to the reference with this delay. The
message of the run reports the delay.

**Preview.** Within the delay each voltage is computed from the reference up to its own sample and
the preview only. With less than 20 samples the next values are predicted from the past, within
the declared band. If 30 % or more of the error at the end of the band would remain, the goal is
refused.

| event | consequence |
|---|---|
| no node publishes within 10 s, or two nodes do | The goal is refused |
| the stage is paced, and the computer too busy for the answers | The goal is refused \
before anything moves, and the message gives the present delay of the computer |
| a run begins | The stage goes to the newest value at rest, and moves from there without a jump |
| a value exceeds the declared amplitude about the centre | The run stops, and the stage \
goes to rest |
| a jump within the amplitude, or a speed above the declared one | It is followed with bounded \
speed and acceleration; the run is degraded if it departs by more than a tenth of the amplitude |
| a value exceeds the range that the model reaches | It is clipped to the range; the run \
is degraded |
| the publisher falls silent | The last value is held. A stage in lockstep first waits for 5 s. \
Later values are followed without a jump; the run is degraded |
| more is published than the stage plays | The oldest values are skipped; the run is degraded |
| values are missing | A straight line bridges up to 0.1 s; the run is degraded |
| an invalid message | It is ignored, and the node's log gives the reason; its values are missing |

A degraded run does not succeed, although it is played to its end: its result has `degraded`, and
`degraded_reason` with the duration. The first moments, before the error counts, are excluded.
Values that are slower than the sample clock are joined by straight lines with kinks: declare twice
their frequency.

## What the preview is worth

The simulated stage follows random references of up to {band_hz:g} Hz and {amplitude_um:g} um for
{duration_s:g} s, with the model that was identified on it. Errors are fractions of
{amplitude_um:g} um. "Known before the run" is the kind `random`, whose stream has a preview of 20
samples.

"""

AFTER = """

The sensor's noise of 9 nm alone is 0.045 %. The second-last column shows the part that the preview
changes. Here the stage has no offset and no drift, so the feedback has nothing to correct: it
slightly amplifies errors above its bandwidth.
"""


def page(rows: Sequence[Followed]) -> str:
    """Return the page as Markdown."""
    return INTRODUCTION.format(band_hz=BAND_HZ, amplitude_um=AMPLITUDE_UM,
                               duration_s=DURATION_S) + table(rows) + AFTER
