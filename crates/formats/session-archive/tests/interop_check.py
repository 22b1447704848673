#!/usr/bin/env python3
"""Opens a PAWS session with the official Python packages and tells what they see, as JSON.

usage: interop_check.py SESSION [--decode]

Nothing of ours is used: `mcap` reads the segments with all its checksum validation on,
`mcap-protobuf-support` decodes every message with the schemas embedded in the files, and with
--decode PyAV decodes the video. The caller compares with what was written. The output:

    segments   how many
    files      per segment: name, profile, library, messages (read in order, read by the index,
               by the statistics), chunks
    topics     per topic: schema, of, log_times, publish_times, sequences, messages (protobuf's
               JSON; of a video message its length, SHA-256 and CRC-32 in place of the data)
    images     with --decode, per video topic and image: width, height, mean and SHA-256 of luma

State that a later segment repeats is listed once. A session that cannot be read ends with a
message and exit code 1.
"""

import argparse
import hashlib
import json
import sys
import zlib
from pathlib import Path

from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

# What these hold stays true until it is replaced, so every segment repeats the newest.
STATE = {"foxglove.CameraCalibration", "foxglove.FrameTransforms", "paws.ClockMap"}


def content(schema, decoded):
    """A message as JSON values."""
    if schema != "foxglove.CompressedVideo":
        return MessageToDict(decoded, preserving_proto_field_name=True)
    return {
        "timestamp": decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos,
        "frame_id": decoded.frame_id,
        "format": decoded.format,
        "bytes": len(decoded.data),
        "sha256": hashlib.sha256(decoded.data).hexdigest(),
        "crc32": zlib.crc32(decoded.data),
    }


def read_segment(path, topics, video):
    """Adds what one segment holds to `topics` and its access units to `video`; returns what there
    is to say of the file."""
    with open(path, "rb") as file:
        # This reader checks the data section's checksum too, and needs no index.
        records = StreamReader(file, validate_crcs=True).records
        in_order = sum(isinstance(record, Message) for record in records)
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        header, summary = reader.get_header(), reader.get_summary()
        found = {}
        # In the order of the file, which is each stream's own order.
        for schema, channel, message, decoded in reader.iter_decoded_messages(
            log_time_order=False
        ):
            found[channel.id] = found.get(channel.id, 0) + 1
            topic = topics.setdefault(
                channel.topic,
                {
                    "schema": schema.name,
                    "of": channel.metadata["of"],
                    "log_times": [],
                    "publish_times": [],
                    "sequences": [],
                    "messages": [],
                },
            )
            known = topic["sequences"]
            if schema.name in STATE and known and message.sequence <= known[-1]:
                continue
            known.append(message.sequence)
            topic["log_times"].append(message.log_time)
            topic["publish_times"].append(message.publish_time)
            topic["messages"].append(content(schema.name, decoded))
            if schema.name == "foxglove.CompressedVideo":
                video.setdefault(channel.topic, (decoded.format, []))[1].append(decoded.data)
    counts = summary.statistics.channel_message_counts
    if found != {channel: count for channel, count in counts.items() if count}:
        raise SystemExit(f"{path}: statistics say {counts}, found {found}")
    return {
        "name": path.name,
        "profile": header.profile,
        "library": header.library,
        "messages": in_order,
        "messages_by_index": sum(found.values()),
        "messages_by_statistics": summary.statistics.message_count,
        "chunks": len(summary.chunk_indexes),
    }


def decode(form, units):
    """Size, mean and SHA-256 of the luma plane of every image, in presentation order."""
    import av
    import numpy

    codec = av.CodecContext.create({"h264": "h264", "h265": "hevc"}[form], "r")
    images = []
    for packet in [av.Packet(unit) for unit in units] + [None]:
        for frame in codec.decode(packet):
            plane = frame.planes[0]
            luma = numpy.frombuffer(plane, numpy.uint8)
            luma = luma.reshape(-1, plane.line_size)[: frame.height, : frame.width]
            images.append(
                {
                    "width": frame.width,
                    "height": frame.height,
                    "luma_mean": float(luma.mean()),
                    "luma_sha256": hashlib.sha256(luma.tobytes()).hexdigest(),
                }
            )
    return images


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("session", type=Path, help="the session's folder")
    arguments.add_argument("--decode", action="store_true", help="decode the video too")
    arguments = arguments.parse_args()
    paths = sorted((arguments.session / "segments").glob("*.mcap"))
    if not paths:
        raise SystemExit(f"no segments in {arguments.session}")
    topics, video = {}, {}
    files = [read_segment(path, topics, video) for path in paths]
    result = {"segments": len(files), "files": files, "topics": topics}
    if arguments.decode:
        result["images"] = {t: decode(form, units) for t, (form, units) in video.items()}
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()
