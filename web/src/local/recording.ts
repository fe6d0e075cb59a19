/** The file that the simulation records its session into: what is written is taken away piece by piece, so that it never grows. */
import { Fd, Inode, wasi } from "@bjorn3/browser_wasi_shim";

export class RecordingFile extends Inode {
  private pieces: Uint8Array[] = [];
  /** Bytes that were written altogether. */
  private length = 0;

  add(piece: Uint8Array): void {
    this.pieces.push(piece.slice());
    this.length += piece.length;
  }

  /** What was written since it was taken last, and where that begins. */
  take(): { readonly bytes: Uint8Array; readonly from: number } {
    const n = this.pieces.reduce((sum, piece) => sum + piece.length, 0);
    const bytes = new Uint8Array(n);
    let at = 0;
    for (const piece of this.pieces) {
      bytes.set(piece, at);
      at += piece.length;
    }
    this.pieces = [];
    return { bytes, from: this.length - n };
  }

  stat(): wasi.Filestat {
    return new wasi.Filestat(this.ino, wasi.FILETYPE_REGULAR_FILE, BigInt(this.length));
  }

  path_open(): { ret: number; fd_obj: Fd } {
    return { ret: wasi.ERRNO_SUCCESS, fd_obj: new OpenRecording(this) };
  }
}

/** Written from its end on, and not read. */
class OpenRecording extends Fd {
  constructor(private readonly file: RecordingFile) {
    super();
  }

  override fd_fdstat_get(): { ret: number; fdstat: wasi.Fdstat } {
    return { ret: wasi.ERRNO_SUCCESS, fdstat: new wasi.Fdstat(wasi.FILETYPE_REGULAR_FILE, 0) };
  }

  override fd_filestat_get(): { ret: number; filestat: wasi.Filestat } {
    return { ret: wasi.ERRNO_SUCCESS, filestat: this.file.stat() };
  }

  override fd_write(data: Uint8Array): { ret: number; nwritten: number } {
    this.file.add(data);
    return { ret: wasi.ERRNO_SUCCESS, nwritten: data.length };
  }

  override fd_sync(): number {
    return wasi.ERRNO_SUCCESS;
  }
}
