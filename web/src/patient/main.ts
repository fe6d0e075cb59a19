/** The page for a new patient that a program serves. */
import { startPatientPage } from "./page";
import { ServedDesk } from "./served_desk";

startPatientPage(new ServedDesk());
