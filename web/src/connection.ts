/** The connection to the simulation: decodes what arrives, reconnects when it is lost. */
import {
  decodeBinary,
  decodeText,
  encodeClientMessage,
  ProtocolError,
  type ClientMessage,
  type Hello,
  type Snapshot,
  type Topology,
} from "./protocol";
import type { Key } from "./coded_positions";
import type { Feel } from "./feel";
import { text } from "./language";
import type { ClassNews, MarksNews } from "./classroom";
import type { TaskNews } from "./task";
import type { Role, Timing } from "./timing";
import type { Parameters } from "./turning/parameters";

export type ConnectionState = "connecting" | "open" | "lost";

export interface ConnectionEvents {
  state(state: ConnectionState, attempt: number): void;
  hello(hello: Hello): void;
  topology(topology: Topology): void;
  snapshot(snapshot: Snapshot, bytes: number): void;
  role(role: Role): void;
  timing(timing: Timing): void;
  feel(feel: Feel): void;
  task(task: TaskNews): void;
  parameters(parameters: Parameters): void;
  classroom(news: ClassNews): void;
  marks(news: MarksNews): void;
  /** An error message of the server, or a message that could not be understood. */
  error(message: string): void;
  /** What is as it should be, and worth knowing. */
  notice(message: string): void;
}

const FIRST_DELAY_MS = 400;
const LONGEST_DELAY_MS = 4000;

/** Wait before the `attempt`-th new try (1-based): doubled each time, at most four seconds. */
export function reconnectDelay_ms(attempt: number): number {
  return Math.min(LONGEST_DELAY_MS, FIRST_DELAY_MS * Math.pow(2, Math.max(0, Math.min(attempt, 20) - 1)));
}

/** `ws(s)://<same host and folder>/ws` of a page. */
export function socketAddress(pageAddress: string): string {
  const address = new URL("ws", pageAddress);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  address.search = "";
  address.hash = "";
  return address.href;
}

/** What a key of the simulation says to the server; a step begins with a pause. */
export function messageOf(
  action: "pause" | "single_step" | "cut" | "clip" | "refine" | "undo",
  paused: boolean | undefined,
  tool: number,
): ClientMessage {
  switch (action) {
    case "pause":
      return { type: "pause", paused: !(paused ?? false) };
    case "single_step":
      return paused === false ? { type: "pause", paused: true } : { type: "single_step" };
    case "cut":
      return { type: "cut", tool };
    case "clip":
      return { type: "clip", tool };
    case "refine":
      return { type: "refine", tool };
    case "undo":
      return { type: "undo" };
  }
}

/** What becomes of a carrier. */
export interface CarrierEvents {
  opened(): void;
  message(data: unknown): void;
  closed(): void;
}

/** What carries messages between the page and its simulation. */
export interface Carrier {
  /** Begins; answers once it is open, and with each message, until it is closed. */
  open(events: CarrierEvents): void;
  /** True if the message went out; what is not open drops it (the next state comes anyway). */
  send(message: string): boolean;
  /** After it was closed: whether it is not to be opened again, because something else is there; null: ask again. */
  isElsewhere(): Promise<boolean | null>;
  /** The report of the task that is over, as a page, where no server has it. */
  report?(): Promise<string>;
}

/** A server's. `isElsewhere`: whether another page is served there. */
export class SocketCarrier implements Carrier {
  private socket: WebSocket | null = null;

  constructor(private readonly address: string, readonly isElsewhere: () => Promise<boolean | null>) {}

  open(events: CarrierEvents): void {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => events.opened();
    socket.onmessage = (event: MessageEvent<unknown>) => events.message(event.data);
    socket.onclose = () => {
      this.socket = null;
      events.closed();
    };
  }

  send(message: string): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(message);
    return true;
  }
}

export class Connection {
  /** Where positions are differences from. */
  private key: Key | null = null;
  private attempt = 0;

  /** `mayEnd`: whether the simulation may have been ended from a page, so that something else may be there. */
  constructor(
    private readonly carrier: Carrier,
    private readonly events: ConnectionEvents,
    private readonly mayEnd: () => boolean = () => false,
  ) {}

  open(): void {
    this.events.state(this.attempt === 0 ? "connecting" : "lost", this.attempt);
    this.carrier.open({
      opened: () => {
        this.attempt = 0;
        this.events.state("open", 0);
      },
      message: (data) => this.receive(data),
      closed: () => this.lose(),
    });
  }

  private lose(): void {
    this.attempt += 1;
    this.events.state("lost", this.attempt);
    setTimeout(() => void this.tryAgain(), reconnectDelay_ms(this.attempt));
  }

  private async tryAgain(): Promise<void> {
    const elsewhere = this.mayEnd() ? await this.carrier.isElsewhere() : false;
    if (elsewhere === null) this.lose();
    else if (!elsewhere) this.open();
  }

  /** Asks for the model after the one that moves the organ now; nothing to do where there is only one. */
  askForNextModel(hello: Hello | null): void {
    if (hello === null || hello.models.length < 2) return;
    const next = (hello.models.indexOf(hello.scene.model) + 1) % hello.models.length;
    this.send({ type: "model", name: hello.models[next] });
  }

  /** True if the message went out. */
  send(message: ClientMessage): boolean {
    return this.carrier.send(encodeClientMessage(message));
  }

  private receive(data: unknown): void {
    try {
      if (typeof data === "string") {
        const message = decodeText(data);
        if (message.type === "hello") this.events.hello(message);
        else if (message.type === "role") this.events.role(message);
        else if (message.type === "timing") this.events.timing(message);
        else if (message.type === "feel") this.events.feel(message);
        else if (message.type === "task") this.events.task(message);
        else if (message.type === "parameters") this.events.parameters(message);
        else if (message.type === "class") this.events.classroom(message);
        else if (message.type === "marks") this.events.marks(message);
        else if (message.type === "news") this.events.notice(message.message);
        else this.events.error(text("server_says", { message: message.message }));
      } else if (data instanceof ArrayBuffer) {
        const message = decodeBinary(data, this.key);
        if (message.kind === "key") this.key = message;
        else if (message.kind === "topology") this.events.topology(message);
        else this.events.snapshot(message, data.byteLength);
      }
    } catch (error) {
      if (!(error instanceof ProtocolError)) throw error;
      this.events.error(text("not_understood", { message: error.message }));
    }
  }
}
