/** Sessions in the browser's storage: what pages recorded, piece by piece, so that a page that is closed or breaks loses next to nothing. */

/** A session that is kept. */
export interface KeptSession {
  readonly id: number;
  /** What its scene is called. */
  readonly name: string;
  /** When it began, and when its last piece was kept [ms since 1970]. */
  readonly begun_ms: number;
  readonly kept_ms: number;
}

/** A session of which nothing came for so long is not recorded by another page any more [ms]. */
export const OVER_AFTER_MS = 10_000;

/** Whether a page may still be recording it. */
export function mayGoOn(session: KeptSession, now_ms: number): boolean {
  return now_ms - session.kept_ms < OVER_AFTER_MS;
}

const [SESSIONS, PIECES] = ["sessions", "pieces"] as const;

/** The answer to a request. */
function answer<T>(request: IDBRequest<T>): Promise<T> {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error ?? new Error("the browser's storage failed"));
  });
}

/** All pieces of a session, in their order. */
const piecesOf = (id: number): IDBKeyRange => IDBKeyRange.bound([id], [id, []]);

export class Kept {
  private constructor(private readonly database: IDBDatabase) {}

  /** @throws where the browser gives no storage, as in some private windows */
  static async open(): Promise<Kept> {
    const request = indexedDB.open("glisson", 1);
    request.onupgradeneeded = () => {
      request.result.createObjectStore(SESSIONS, { keyPath: "id" });
      request.result.createObjectStore(PIECES);
    };
    return new Kept(await answer(request));
  }

  /** Changes both stores, or neither; comes when that is written. */
  private change(act: (sessions: IDBObjectStore, pieces: IDBObjectStore) => void): Promise<void> {
    const transaction = this.database.transaction([SESSIONS, PIECES], "readwrite");
    act(transaction.objectStore(SESSIONS), transaction.objectStore(PIECES));
    return new Promise((resolve, reject) => {
      transaction.oncomplete = () => resolve();
      transaction.onabort = () => reject(transaction.error ?? new Error("the browser's storage failed"));
    });
  }

  /** The session goes on, or begins, with these bytes, from byte `from` on. */
  add(session: KeptSession, bytes: Uint8Array, from: number): Promise<void> {
    return this.change((sessions, pieces) => {
      sessions.put(session);
      pieces.put(bytes, [session.id, from]);
    });
  }

  private read<T>(store: string, ask: (store: IDBObjectStore) => IDBRequest<T>): Promise<T> {
    return answer(ask(this.database.transaction(store, "readonly").objectStore(store)));
  }

  /** The oldest first. */
  async list(): Promise<KeptSession[]> {
    return (await this.read(SESSIONS, (store) => store.getAll())) as KeptSession[];
  }

  /** The bytes of a session. */
  async session(id: number): Promise<Blob> {
    return new Blob((await this.read(PIECES, (store) => store.getAll(piecesOf(id)))) as BlobPart[]);
  }

  forget(id: number): Promise<void> {
    return this.change((sessions, pieces) => {
      sessions.delete(id);
      pieces.delete(piecesOf(id));
    });
  }
}
