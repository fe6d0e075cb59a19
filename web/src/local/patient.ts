/** The page for a new patient that does all by itself: one file, opened from disk. */
import { startPatientPage } from "../patient/page";
import { compiled, emptySimulator, programLetters, simulatorWith } from "./parts";
import { WorkerDesk } from "./patient_desk";
import Beside from "./patient_worker?worker&inline";

const program = programLetters();
const empty = emptySimulator();
const desk = new WorkerDesk(() => new Beside(), compiled(program), async (files, scene) => simulatorWith(await empty, program, { scene, files }));
// What is in the page goes with it: of leaving, loading it anew and another language the browser asks first.
window.addEventListener("beforeunload", (event) => {
  if (desk.hasImage) event.preventDefault();
});
startPatientPage(desk);
