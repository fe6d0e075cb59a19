/** Files that were dropped or chosen, with what is in dropped folders. */

/** Names of files that operating systems add to folders. */
const NOT_OF_IMAGE = /^(\.|Thumbs\.db$|desktop\.ini$)/;

function entriesOf(reader: FileSystemDirectoryReader): Promise<FileSystemEntry[]> {
  return new Promise((resolve, reject) => reader.readEntries(resolve, reject));
}

async function filesIn(entry: FileSystemEntry): Promise<File[]> {
  if (entry.isFile) {
    return [await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject))];
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const files: File[] = [];
  // A folder tells its entries in parts.
  for (let part = await entriesOf(reader); part.length > 0; part = await entriesOf(reader)) {
    for (const inner of part) files.push(...(await filesIn(inner)));
  }
  return files;
}

/** The files of a drop, without those that are of no image. */
export async function droppedFiles(transfer: DataTransfer): Promise<File[]> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const files = entries.length > 0 ? (await Promise.all(entries.map(filesIn))).flat() : [...transfer.files];
  return imageFiles(files);
}

export function imageFiles(files: readonly File[]): File[] {
  return files.filter((file) => !NOT_OF_IMAGE.test(file.name));
}
