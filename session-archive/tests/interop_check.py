#!/usr/bin/env python3
"""Reads a session with the official MCAP packages and prints what it finds as JSON.

    interop_check.py SESSION [--decode]

Nothing of this project is used: messages are decoded with the schemas embedded in the files. Every
checksum is checked. With --decode, the pictures of every foxglove.CompressedVideo stream are decoded
with PyAV, and the mean and SHA-256 of each picture's luma are printed too.

The output: {"segments": [...], "streams": {TOPIC: {"schema": ..., "messages": [...]}},
"pictures": {TOPIC: [...]}}. A message is {"log_time", "publish_time", "sequence", "fields"}, where
fields holds what is not at its default; byte strings are given as {"bytes", "crc32"}. A session
that cannot be read ends with a message and exit code 1.
"""

import argparse
import hashlib
import json
import pathlib
import sys
import zlib

from mcap.reader import make_reader
from mcap.records import Channel, DataEnd, Footer, Header, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

# What these hold stays true until it is replaced, so every segment repeats the newest.
STATE = {"foxglove.CameraCalibration", "foxglove.FrameTransforms", "paws.ClockMap"}


def plain(message):
    """A protobuf message as JSON values."""

    def value(v):
        if isinstance(v, bytes):
            return {"bytes": len(v), "crc32": zlib.crc32(v)}
        return plain(v) if hasattr(v, "ListFields") else v

    def field(v):
        repeated = not isinstance(v, (str, bytes)) and hasattr(v, "__len__")
        return [value(x) for x in v] if repeated else value(v)

    return {f.name: field(v) for f, v in message.ListFields()}


def read_segment(path, streams, units, seen):
    """Adds the messages of one segment to `streams`, its access units to `units`; returns what the
    segment says of itself."""
    schemas, channels, decoders = {}, {}, {}
    factory = DecoderFactory()
    header, footer, data_end, count = None, None, False, 0
    with open(path, "rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Header):
                header = record
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, DataEnd):
                data_end = True
            elif isinstance(record, Footer):
                footer = record
            elif isinstance(record, Message):
                count += 1
                channel = channels[record.channel_id]
                schema = schemas[channel.schema_id]
                if schema.name in STATE:
                    if record.sequence <= seen.get(channel.topic, -1):
                        continue
                    seen[channel.topic] = record.sequence
                if channel.id not in decoders:
                    decoders[channel.id] = factory.decoder_for(
                        channel.message_encoding, schema
                    )
                message = decoders[channel.id](record.data)
                stream = streams.setdefault(
                    channel.topic,
                    {"schema": schema.name, "of": channel.metadata["of"], "messages": []},
                )
                stream["messages"].append(
                    {
                        "log_time": record.log_time,
                        "publish_time": record.publish_time,
                        "sequence": record.sequence,
                        "fields": plain(message),
                    }
                )
                if schema.name == "foxglove.CompressedVideo":
                    units.setdefault(channel.topic, []).append(
                        (record.log_time, message.format, message.data)
                    )
    with open(path, "rb") as file:
        reader = make_reader(
            file, validate_crcs=True, decoder_factories=[DecoderFactory()]
        )
        summary = reader.get_summary()
        indexed = sum(1 for _ in reader.iter_decoded_messages())
    return {
        "file": path.name,
        "profile": header.profile,
        "library": header.library,
        "messages": count,
        "messages_by_index": indexed,
        "messages_by_statistics": summary.statistics.message_count,
        "chunks": len(summary.chunk_indexes),
        "ended": data_end and footer is not None and footer.summary_start > 0,
    }


def decode(units):
    """The pictures of one stream: time, size, and mean and SHA-256 of the luma of each."""
    import av
    import numpy

    codec = {"h264": "h264", "h265": "hevc"}[units[0][1]]
    decoder = av.CodecContext.create(codec, "r")
    decoder.thread_count = 1
    pictures = []
    packets = [av.Packet(data) for _, _, data in units]
    for packet in packets + [None]:
        for frame in decoder.decode(packet):
            plane = frame.planes[0]
            luma = numpy.frombuffer(plane, numpy.uint8)
            luma = luma.reshape(plane.height, plane.line_size)[:, : plane.width]
            pictures.append((frame.width, frame.height, luma.copy()))
    if len(pictures) != len(units):
        raise SystemExit(f"{len(units)} access units gave {len(pictures)} pictures")
    # There are no B frames: pictures come in the order of their access units.
    return [
        {
            "log_time": time,
            "width": width,
            "height": height,
            "mean": float(luma.mean()),
            "sha256": hashlib.sha256(luma.tobytes()).hexdigest(),
        }
        for (time, _, _), (width, height, luma) in zip(units, pictures)
    ]


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("session", type=pathlib.Path, help="the session's folder")
    arguments.add_argument("--decode", action="store_true", help="decode the video too")
    arguments = arguments.parse_args()
    files = sorted((arguments.session / "segments").glob("*.mcap"))
    if not files:
        raise SystemExit(f"no segments in {arguments.session}")
    streams, units, seen = {}, {}, {}
    segments = [read_segment(path, streams, units, seen) for path in files]
    found = {"segments": segments, "streams": streams}
    if arguments.decode:
        found["pictures"] = {topic: decode(all) for topic, all in units.items()}
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
