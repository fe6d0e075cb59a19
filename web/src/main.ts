/** The viewer of a simulation that a program serves. */
import { SocketCarrier, socketAddress } from "./connection";
import { goesElsewhere } from "./leaving";
import { startViewer } from "./start_viewer";

startViewer(() => new SocketCarrier(socketAddress(window.location.href), goesElsewhere));
