// A viewer that uses the public client library of the Foxglove WebSocket protocol, run as a program of its own by the tests.
//
// node foxglove.mjs PORT PLAN
//
// PLAN is JSON: {"subscribe": [topics], "publish": [{"topic", "schemaName", "message"}], "call": [{"service", "request"}],
// "parameters": [names], "set": [parameters], "graph": true, "asset": "package://..."}. Messages are decoded with the
// library's own parser, by the schema of their channel. One JSON line is written per thing that happens; an empty line on
// stdin makes it publish once more, and the end of stdin ends it.

import { createInterface } from "node:readline";
import protocol from "@foxglove/ws-protocol";
import definitions from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg2-serialization";
import { WebSocket } from "ws";

const { FoxgloveClient } = protocol;
const { parse } = definitions;
const { MessageReader } = serialization;
const [port, text] = process.argv.slice(2);
const plan = JSON.parse(text);

const plainly = (_, value) => {
  if (typeof value === "bigint") return value.toString();
  if (ArrayBuffer.isView(value)) return Array.from(value);
  return value;
};
const say = (what) => process.stdout.write(JSON.stringify(what, plainly) + "\n");

const socket = new WebSocket(`ws://127.0.0.1:${port}`, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const readers = new Map();
const services = new Map();
const published = [];
let calls = 0;

const reader = (schema) => new MessageReader(parse(schema, { ros2: true }));

client.on("open", () => {
  say({ client: 0, connected: socket.protocol });
  for (const { topic, schemaName } of plan.publish ?? []) {
    published.push(client.advertise({ topic, encoding: "json", schemaName }));
  }
  if (plan.parameters) client.getParameters(plan.parameters, "get");
  if (plan.set) client.setParameters(plan.set, "set");
  if (plan.watch) client.subscribeParameterUpdates(plan.watch);
  if (plan.graph) client.subscribeConnectionGraph();
  if (plan.asset) client.fetchAsset(plan.asset, 1);
});
client.on("error", (error) => say({ error: String(error) }));
client.on("close", ({ code, reason }) => say({ closed: code, reason: String(reason ?? "") }));
client.on("serverInfo", (info) => say({ serverInfo: info }));
client.on("status", (status) => say({ status }));
client.on("removeStatus", (removed) => say({ removeStatus: removed.statusIds }));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    say({ channel: channel.topic, schemaName: channel.schemaName });
    if ((plan.subscribe ?? []).includes(channel.topic)) {
      const id = client.subscribe(channel.id);
      readers.set(id, { topic: channel.topic, reader: reader(channel.schema) });
    }
  }
});
client.on("unadvertise", (ids) => say({ unadvertise: ids }));
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const { topic, reader } = readers.get(subscriptionId);
  say({ topic, timestamp, message: reader.readMessage(data) });
});
client.on("advertiseServices", (found) => {
  for (const service of found) {
    services.set(service.id, service);
    for (const { service: name, request } of plan.call ?? []) {
      if (name !== service.name) continue;
      const data = new TextEncoder().encode(JSON.stringify(request));
      client.sendServiceCallRequest({ serviceId: service.id, callId: ++calls, encoding: "json", data });
    }
  }
});
client.on("serviceCallResponse", ({ serviceId, callId, data }) => {
  say({ service: services.get(serviceId).name, callId, response: JSON.parse(new TextDecoder().decode(data)) });
});
client.on("serviceCallFailure", ({ callId, message }) => say({ callId, failure: message }));
client.on("parameterValues", ({ id, parameters }) => say({ parameters, id }));
client.on("connectionGraphUpdate", (update) => say({ graph: update }));
client.on("fetchAssetResponse", ({ requestId, status, error, data }) => {
  say({ asset: requestId, status, error, text: data ? new TextDecoder().decode(data) : undefined });
});

const lines = createInterface({ input: process.stdin });
lines.on("line", () => {
  published.forEach((id, number) => {
    client.sendMessage(id, new TextEncoder().encode(JSON.stringify(plan.publish[number].message)));
  });
});
lines.on("close", () => process.exit(0));
