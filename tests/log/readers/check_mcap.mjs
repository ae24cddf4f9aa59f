// Reads an MCAP with the official TypeScript library: every record, chunk CRCs validated, once by its index and once as a stream.
// node check_mcap.mjs FILE: prints {"messages": .., "topics": {topic: count}} or fails. The packages lie in $NODE_MODULES.
import { createReadStream } from "node:fs";
import { open } from "node:fs/promises";
import { createRequire } from "node:module";

const require = createRequire(process.argv[3] + "/");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");

const decompressHandlers = await loadDecompressHandlers();
const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
const topics = {};
let messages = 0;
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const topic = reader.channelsById.get(message.channelId).topic;
  topics[topic] = (topics[topic] ?? 0) + 1;
  messages++;
}
await file.close();

const stream = new McapStreamReader({ validateCrcs: true, decompressHandlers });
let streamed = 0;
let finished = false;
for await (const data of createReadStream(process.argv[2])) {
  stream.append(data);
  for (let record; (record = stream.nextRecord()); ) {
    if (record.type === "Message") streamed++;
    if (record.type === "Footer") finished = true;
  }
}
if (streamed !== messages || !finished) {
  throw new Error(`${streamed} messages streamed, ${messages} by the index, footer ${finished}`);
}
if (Number(reader.statistics.messageCount) !== messages) {
  throw new Error(`statistics say ${reader.statistics.messageCount}, there are ${messages}`);
}
console.log(JSON.stringify({ messages, topics }));
