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

A joystick, another controller or a vision loop can make the reference while the stage follows it.
It publishes `piezo_interfaces/ReferenceSamples` on the topic `reference` of the stage's namespace,
and a goal of `controller/track` names the kind `topic`:

```
ros2 action send_goal /controller/track piezo_interfaces/action/Track "{{
  reference: {{kind: topic, frequency_hz: [100.0], amplitude_um: [20.0]}},
  model: runs/first/model.json, mode: composite, duration_s: 60.0, directory: runs/first}}"
```

| part | meaning |
|---|---|
| `frequency_hz`, `amplitude_um` of the goal | The highest frequency and the largest \
peak-to-peak amplitude that are published. What keeps to them is followed exactly: by \
Bernstein's inequality it is never faster than the bounds of speed and acceleration that follow \
from them |
| `centre_um` of the goal | Added to what is published, which then lies within half of the \
amplitude from it. With 0, what \
is published lies anywhere, within one amplitude |
| `first_sample` | Number of the first value of the message, counted without gaps. A value that \
comes twice counts once, and a straight line bridges what is left out. Zero begins anew |
| `sample_period_s` | Distance of the values, a whole multiple of the sample clock's period; 0 \
for that period. Straight lines join slow values |
| `preview_samples` | How many samples of the clock the last value lies ahead of the publisher's \
present. The first message of a run decides |
| mode | `feedforward` or `composite`. The feedforward is streamed, and the node answers the \
feedback, as for every streamed reference |

**Delay.** What is published is followed a constant time later: 20 ms for messages that come late,
and the length of two messages. The error of a run is that from the reference at this delay. The
run's message tells the delay.

**Preview.** Within the delay each voltage is computed from the reference up to its own sample and
the preview, and no further. With less than 20 samples the past predicts what comes next, within
the declared band. Where 30 % or more of the end of the band would be left, the goal is refused.

| what happens | what follows |
|---|---|
| nobody publishes within 10 s, or two nodes do | the goal is refused |
| the stage is paced, and the computer too busy for the answers | The goal is refused \
before anything moves, with how late the computer just was |
| a run begins | The stage goes to the newest value at rest, and moves from there without a jump |
| a value beyond the declared amplitude, about the centre | The run stops, and the stage \
goes to rest |
| a jump within it, or a speed beyond the declared | It is followed with the bounded speed and \
acceleration; the run is degraded if it departs by more than a tenth of the amplitude |
| a value beyond the range that the model reaches | It is clipped to the range; the run \
is degraded |
| the publisher falls silent | The last value is held. A stage in lockstep first waits for 1 s. \
What comes next is followed without a jump; the run is degraded |
| more is published than the stage plays | The oldest values are left out; the run is degraded |
| values are left out | A straight line bridges up to 0.1 s; the run is degraded |
| a message without meaning | It is ignored, and the node's log says why; its values are left out |

A degraded run does not succeed, although it is played to its end: its result has `degraded`, and
`degraded_reason` with how long. The first moments, until the error counts, are excepted. Values
that come slower than the sample clock are joined by kinks: declare twice their frequency.

## What the preview is worth

The simulated stage follows random references of up to {band_hz:g} Hz and {amplitude_um:g} um for
{duration_s:g} s, with the model that was identified on it. Errors are parts of {amplitude_um:g} um.
"Known before the run" is the kind `random`, whose stream looks 20 samples ahead.

"""

AFTER = """

The sensor's noise of 9 nm alone is 0.045 %. The last column but one shows the part that the preview
changes. Here the stage has no offset and no drift, so that the feedback has nothing to remove: it
amplifies a little what lies above its bandwidth.
"""


def page(rows: Sequence[Followed]) -> str:
    """Return the page as Markdown."""
    return INTRODUCTION.format(band_hz=BAND_HZ, amplitude_um=AMPLITUDE_UM,
                               duration_s=DURATION_S) + table(rows) + AFTER
