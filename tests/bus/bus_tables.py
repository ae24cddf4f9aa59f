"""A small table of topics and calls: one row for each kind of delivery."""

from schemas import Call, ColorImage, Control, Health, Pose, Tick, Topic

PUBLISHER = ("publisher", "second")

TOPICS = {
    topic.key: topic
    for topic in (
        Topic("steady", Pose, PUBLISHER, cache=8192),
        Topic("hider/pose", Pose, PUBLISHER),
        Topic("seeker/pose", Pose, PUBLISHER),
        Topic("hider/extra/pose", Pose, PUBLISHER),
        Topic("picture", ColorImage, PUBLISHER, cache=2048),
        Topic("tiny", Pose, PUBLISHER, cache=16),
        Topic("deep", Pose, PUBLISHER, history=3, cache=16),
        Topic("wish", Pose, PUBLISHER, history=0, cache=16),
        Topic("newest", Pose, PUBLISHER, delivery="latest"),
        Topic("health/publisher", Health, PUBLISHER),
    )
}

CALLS = {"question": Call("question", Control, Tick, server="server")}


def pose(stamp: int) -> Pose:
    return Pose(stamp=stamp, x=0.5, y=0.5, heading=0.0)


def question(seed: int) -> Control:
    return Control(stamp=seed, action="start", seed=seed)
