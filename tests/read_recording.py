"""Reads a recording with the Python package mcap and checks that every kind of topic is there and every message is JSON."""

import json
import sys
from collections import Counter

from mcap.reader import make_reader

topics = Counter()
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file)
    for schema, channel, message in reader.iter_messages():
        assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
        json.loads(schema.data)
        json.loads(message.data)
        topics[channel.topic.rsplit("/", 1)[1]] += 1
    counted = reader.get_summary().statistics.message_count
assert counted == sum(topics.values()), (counted, topics)
for kind in ["requests", "responses", "clock", "planned", "reported", "decisions", "progress"]:
    assert topics[kind] > 0, (kind, topics)
print(f"{counted} messages: {dict(topics)}")
