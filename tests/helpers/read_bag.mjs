// Reads an MCAP file with @mcap/core and prints, for each topic, how many messages it holds and a
// digest of all the numbers in them: node read_bag.mjs FILE, beside a node_modules folder.
import crypto from "node:crypto";
import fs from "node:fs/promises";
import path from "node:path";
import { createRequire } from "node:module";

const require = createRequire(path.join(process.cwd(), "index.js"));
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const file = await fs.open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const bytes = new Uint8Array(Number(length));
    await file.read(bytes, 0, Number(length), Number(offset));
    return bytes;
  },
};
const decompressHandlers = await loadDecompressHandlers();
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const topics = new Map();
for (const channel of reader.channelsById.values()) {
  const text = new TextDecoder().decode(reader.schemasById.get(channel.schemaId).data);
  topics.set(channel.id, {
    name: channel.topic,
    reader: new MessageReader(parse(text, { ros2: true })),
    count: 0,
    digest: crypto.createHash("sha256"),
  });
}

// Every number of a message in the order of its fields; times are {sec, nsec} here.
function* numbers(value) {
  if (typeof value === "number") yield value;
  else if (typeof value === "bigint" || typeof value === "boolean") yield Number(value);
  else if (value !== null && typeof value === "object")
    for (const part of ArrayBuffer.isView(value) ? value : Object.values(value)) yield* numbers(part);
}

for await (const message of reader.readMessages()) {
  const topic = topics.get(message.channelId);
  const values = Float64Array.from(numbers(topic.reader.readMessage(message.data)));
  topic.digest.update(Buffer.from(values.buffer));
  topic.count += 1;
}
for (const { name, count, digest } of topics.values())
  console.log(`${name} ${count} ${digest.digest("hex")}`);
