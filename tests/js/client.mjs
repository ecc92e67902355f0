// Clients of roslibjs, run as a program of their own by the tests.
//
// node client.mjs roslib1|roslib2 PORT PLAN
//
// PLAN is JSON: {"clients": n, "subscribe": [options of a Topic], "publish": [options of a Topic and "message"]}; an
// item with "client" is for that one only, "#" in a name stands for the number of the client. One JSON line is
// written per thing that happens; a line on stdin makes every client publish once more, the end of stdin ends it.

import { createInterface } from "node:readline";

const [library, port, text] = process.argv.slice(2);
const loaded = await import(library);
const ROSLIB = loaded.default ?? loaded;
const plan = JSON.parse(text);

const say = (what) => process.stdout.write(JSON.stringify(what, plainly) + "\n");

function plainly(_, value) {
  if (typeof value === "bigint") return value.toString();
  if (ArrayBuffer.isView(value)) return { kind: value.constructor.name, values: Array.from(value) };
  if (value?.type === "Buffer" && Array.isArray(value.data)) return { kind: "Buffer", values: value.data };
  return value;
}

function topic(ros, number, { client, message, type, name, ...options }) {
  return new ROSLIB.Topic({ ros, name: name.replace("#", number), messageType: type, ...options });
}

const publishers = [];
const mine = (items, number) => (items ?? []).filter((item) => (item.client ?? number) === number);

for (let number = 0; number < (plan.clients ?? 1); number++) {
  const ros = new ROSLIB.Ros({ url: `ws://127.0.0.1:${port}` });
  ros.on("error", (error) => say({ client: number, error: String(error?.message ?? error) }));
  ros.on("close", () => say({ client: number, closed: true }));
  ros.on("connection", () => {
    for (const item of mine(plan.subscribe, number)) {
      const reader = topic(ros, number, item);
      reader.subscribe((message) => say({ client: number, topic: reader.name, message }));
      if (item.once) reader.on?.("message", () => reader.unsubscribe());
    }
    for (const item of mine(plan.publish, number)) {
      const writer = topic(ros, number, item);
      writer.advertise();
      publishers.push([writer, item.message]);
    }
    say({ client: number, connected: true });
  });
}

const lines = createInterface({ input: process.stdin });
lines.on("line", () => {
  for (const [writer, message] of publishers) {
    writer.publish(ROSLIB.Message ? new ROSLIB.Message(message) : message);
  }
});
lines.on("close", () => process.exit(0));
