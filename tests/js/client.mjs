// Clients of roslibjs, run as a program of their own by the tests.
//
// node client.mjs roslib1|roslib2 PORT PLAN
//
// PLAN is JSON: {"clients": n, "subscribe": [options of a Topic], "publish": [options of a Topic and "message"],
// "serve": [a service, with the "values" of its answers, or under "fail" the text of what it throws], "act": [an action
// that counts to the "order" of its goals]}; an item with "client" is for that one only, "#" in a name stands for the
// number of the client. One JSON line is written per thing that happens.
//
// An empty line on stdin makes every client publish once more. A line with JSON is for one client, or for all: {"call":
// name, "type", "args"}, {"goal": name, "type", "args"}, {"cancel": name, "type", and "id" if it is not for all goals},
// {"ask": a method of Ros, "args"}. The end of stdin ends it.

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

function serve(ros, number, { name, type, values, fail }) {
  const service = new ROSLIB.Service({ ros, name: name.replace("#", number), serviceType: type });
  service.advertise((request, response) => {
    say({ client: number, asked: service.name, args: request });
    if (fail) throw new Error(fail);
    Object.assign(response, values);
    return true;
  });
}

function act(ros, number, { name, type }) {
  const action = new ROSLIB.Action({ ros, name, actionType: type });
  const count = (to) => Array.from({ length: Math.max(to, 0) }, (_, i) => i);
  action.advertise(
    (goal, id) => {
      say({ client: number, asked: name, args: goal, id });
      if (goal.order < 0) return action.setFailed(id);
      if (goal.order > 100) return undefined; // until it is cancelled
      count(goal.order).forEach((i) => action.sendFeedback(id, { sequence: count(i + 1) }));
      return action.setSucceeded(id, { sequence: count(goal.order) });
    },
    (id) => {
      say({ client: number, cancel: name, id });
      action.setCanceled(id, { sequence: [5] });
    },
  );
}

function carryOut(ros, number, command) {
  const { call, goal, cancel, ask, type, args, id } = command;
  const answered = (values) => say({ client: number, answered: call ?? ask, values });
  const failed = (error) => say({ client: number, failed: call ?? goal ?? ask, text: String(error?.message ?? error) });
  if (call) {
    new ROSLIB.Service({ ros, name: call, serviceType: type }).callService(args ?? {}, answered, failed);
  } else if (goal) {
    const sent = new ROSLIB.Action({ ros, name: goal, actionType: type }).sendGoal(
      args,
      (values) => say({ client: number, result: goal, values }),
      (values) => say({ client: number, feedback: goal, values }),
      failed,
    );
    say({ client: number, sent: goal, id: sent });
  } else if (cancel) {
    const action = new ROSLIB.Action({ ros, name: cancel, actionType: type });
    if (id) action.cancelGoal(id);
    else action.cancelAllGoals();
  } else if (ask) {
    ros[ask](...(args ?? []), answered, failed);
  }
}

const clients = [];
const publishers = [];
const mine = (items, number) => (items ?? []).filter((item) => (item.client ?? number) === number);

for (let number = 0; number < (plan.clients ?? 1); number++) {
  const ros = new ROSLIB.Ros({ url: `ws://127.0.0.1:${port}` });
  clients.push(ros);
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
    mine(plan.serve, number).forEach((item) => serve(ros, number, item));
    mine(plan.act, number).forEach((item) => act(ros, number, item));
    say({ client: number, connected: true });
  });
}

const lines = createInterface({ input: process.stdin });
lines.on("line", (line) => {
  if (line) {
    const command = JSON.parse(line);
    clients.forEach((ros, number) => (command.client ?? number) === number && carryOut(ros, number, command));
    return;
  }
  for (const [writer, message] of publishers) {
    writer.publish(ROSLIB.Message ? new ROSLIB.Message(message) : message);
  }
});
lines.on("close", () => process.exit(0));
